"""The unit of one configuration: the shipped one with what this configuration needs in its place."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.daemon import systemd_unit as installing
from candaemon.daemon.systemd_unit import install, unit_text
from candaemon.errors import ConfigError, InputError
from tests.support.paths import ROOT

UNIT = ROOT / "config" / "systemd" / "candaemon@.service"
PROGRAM = ["/opt/candaemon/bin/candaemon"]


def settings(unit: str) -> dict[str, list[str]]:
    """Return the settings of a unit, each with its values in order."""
    found: dict[str, list[str]] = {}
    for line in unit.splitlines():
        name, sign, value = line.partition("=")
        if sign and not line.startswith("#"):
            found.setdefault(name, []).append(value)
    return found


def configuration(folder: Path, *changes: tuple[str, str], name: str = "front.yaml") -> Path:
    text = (ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def bound(path: Path) -> Binding:
    return bind(load_config(path))


def differing(unit: str) -> dict[str, list[str]]:
    """Return the settings that are not as in the shipped unit."""
    shipped = settings(UNIT.read_text(encoding="utf-8"))
    made = settings(unit)
    assert made.keys() == shipped.keys()
    return {name: values for name, values in made.items() if sorted(values) != sorted(shipped[name])}


def test_a_socketcan_configuration_needs_only_its_own_path(tmp_path: Path) -> None:
    path = configuration(tmp_path)
    unit = unit_text(bound(path), PROGRAM)
    assert differing(unit).keys() == {"ExecStart", "RestrictAddressFamilies"}
    assert settings(unit)["ExecStart"] == [f"/opt/candaemon/bin/candaemon run {path}"]
    assert set(settings(unit)["RestrictAddressFamilies"][0].split()) == {"AF_CAN", "AF_INET", "AF_UNIX"}


def test_multicast_buses_may_speak_to_their_groups_and_need_no_can(tmp_path: Path) -> None:
    path = configuration(
        tmp_path, *((f"channel: can{k}", f"interface: udp_multicast, channel: 239.0.0.{k}") for k in (1, 2, 3))
    )
    unit = settings(unit_text(bound(path), PROGRAM))
    assert unit["RestrictAddressFamilies"] == ["AF_INET AF_UNIX"]
    assert unit["IPAddressAllow"] == ["localhost multicast"]
    assert unit["IPAddressDeny"] == ["any"]


def test_a_driver_of_its_own_may_reach_its_device(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = configuration(tmp_path, ("channel: can1", "interface: pcan, channel: PCAN_USBBUS1"))
    unit = settings(unit_text(bound(path), PROGRAM))
    assert unit["PrivateDevices"] == ["no"]
    assert "bus 'radar': the unit lets 'pcan' reach every device" in caplog.text


def test_a_virtual_bus_cannot_be_served(tmp_path: Path) -> None:
    path = configuration(tmp_path, ("channel: can2", "interface: virtual, channel: x"))
    with pytest.raises(ConfigError, match=r"front\.yaml:6: buses\.ins\.interface: found 'virtual'"):
        unit_text(bound(path), PROGRAM)


def test_a_path_is_quoted_as_systemd_reads_it(tmp_path: Path) -> None:
    folder = tmp_path / 'a "good" 100% $place'
    folder.mkdir()
    unit = settings(unit_text(bound(configuration(folder)), PROGRAM))
    assert unit["ExecStart"][0].endswith('/a \\"good\\" 100%% $$place/front.yaml"')


def test_a_program_below_a_dollar_is_named_as_it_is(tmp_path: Path) -> None:
    unit = settings(unit_text(bound(configuration(tmp_path)), ["/opt/$a 5%/candaemon", "$b"]))
    assert unit["ExecStart"][0].startswith('"/opt/$a 5%%/candaemon" $$b run /')


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_reads_the_command_as_it_was(tmp_path: Path) -> None:
    folder, opt = tmp_path / """a 'b' "c" 5%n $HOME ${HOME} \\n ;""", tmp_path / "5%n $HOME ${HOME} ;"
    folder.mkdir()
    opt.mkdir()
    program = Path(shutil.copy("/bin/true", opt / "candaemon"))
    unit = tmp_path / "front.service"
    unit.write_text(unit_text(bound(configuration(folder)), [str(program)]), encoding="utf-8")
    told = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False)
    assert "is not executable" not in told.stderr
    assert "front.service:" not in told.stderr


@pytest.mark.parametrize("mark", ["\n", "\r", "\t", "\x1b", "\x85", "\u2028", "\u2029", "\udcff"])
def test_a_path_that_a_unit_cannot_hold_is_refused(tmp_path: Path, mark: str) -> None:
    folder = tmp_path / f"a{mark}ExecStartPre=b"
    folder.mkdir()
    binding = bound(configuration(folder))
    with pytest.raises(ConfigError, match=r"ExecStartPre=b/front\.yaml' holds a control character, .* rename the"):
        unit_text(binding, PROGRAM)
    with pytest.raises(ConfigError, match="ExecStartPre=b' holds a control character"):
        unit_text(bound(configuration(tmp_path)), [f"/opt/{mark}ExecStartPre=b"])


@pytest.mark.parametrize("group", ["ff15:7079:7468:6f6e:6465:6d6f:6d63:6173", "ff02::1%lo", "group.example"])
def test_a_group_of_ipv6_gets_its_address_family(tmp_path: Path, group: str) -> None:
    path = configuration(tmp_path, ("channel: can1", f"interface: udp_multicast, channel: '{group}'"))
    unit = settings(unit_text(bound(path), PROGRAM))
    assert unit["RestrictAddressFamilies"] == ["AF_CAN AF_INET AF_INET6 AF_UNIX"]


def test_a_name_that_systemd_would_escape_is_refused(tmp_path: Path) -> None:
    path = configuration(tmp_path, name="my front.yaml")
    with pytest.raises(ConfigError, match=r"'my front' cannot be the name of a service; rename"):
        install(path, show=True)


@pytest.mark.parametrize("name", ["front.left", "a" * 22])
def test_a_name_that_no_user_can_have_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=rf"'{name}' cannot be the name of a service; .*21 at most"):
        install(configuration(tmp_path, name=f"{name}.yaml"), show=True)


def test_what_cannot_be_served_is_not_installed(tmp_path: Path) -> None:
    path = configuration(tmp_path, ("channel: can1", "interface: socketcam, channel: can1"))
    with pytest.raises(ConfigError, match=r"buses\.radar\.interface: found 'socketcam', expected an interface"):
        install(path, show=False, units=tmp_path)
    assert not list(tmp_path.glob("*.service"))


def test_what_the_unit_hides_is_a_warning_where_it_is_printed(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(installing, "_HIDDEN", {"PrivateTmp=yes": (tmp_path,)})
    install(configuration(tmp_path), show=True)
    assert capsys.readouterr().out.startswith("# One instance a configuration")
    assert f"front.yaml lies below {tmp_path}, which the unit hides (PrivateTmp=yes)" in caplog.text


def test_what_the_service_cannot_read_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installing, "_HIDDEN", {})
    path = configuration(tmp_path)
    path.chmod(0o600)
    with pytest.raises(InputError, match=r"front\.yaml cannot be read by all users; `chmod o\+r "):
        install(path, show=False, units=tmp_path)


def test_the_unit_is_written_as_an_instance_of_the_template(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(installing, "_unreadable", lambda _path: ())
    install(configuration(tmp_path), show=False, units=tmp_path)
    assert settings((tmp_path / "candaemon@front.service").read_text())["WatchdogSec"] == ["5"]
    assert "systemctl enable --now candaemon@front" in capsys.readouterr().out


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_the_unit_is_hardened(tmp_path: Path) -> None:
    (tmp_path / "candaemon@front.service").write_text(UNIT.read_text(encoding="utf-8"), encoding="utf-8")
    told = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(tmp_path / "candaemon@front.service")],
        capture_output=True,
        text=True,
        check=True,
    )
    exposure = float(told.stdout.split("exposure level for")[1].split(":")[1].split()[0])
    assert exposure <= 1.2
