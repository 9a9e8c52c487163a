"""Files are written whole or not at all, and never over what is read."""

from __future__ import annotations

import fcntl
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from candaemon.errors import ConfigError, InputError
from candaemon.files.outputs import OutputFile, Outputs, make_folder, write_file


def names(folder: Path) -> list[str]:
    return sorted(each.name for each in folder.iterdir())


def test_a_file_is_replaced_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_file(path, "a long first one\n")
    write_file(path, "β\n")
    assert path.read_text(encoding="utf-8") == "β\n"
    assert names(tmp_path) == ["a.json"]


def test_a_link_goes_on_pointing_to_its_file_which_is_replaced_whole(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    link, target = tmp_path / "latest.json", tmp_path / "runs" / "7.json"
    link.symlink_to(target)
    write_file(link, "first")
    opened = target.open(encoding="utf-8")
    write_file(link, "second")
    with opened:
        assert opened.read() == "first"  # whoever reads it reads one of the two
    assert link.is_symlink()
    assert target.read_text(encoding="utf-8") == "second"
    assert names(target.parent) == ["7.json"]


def test_a_replaced_file_keeps_its_mode_and_a_new_one_has_the_usual_one(tmp_path: Path) -> None:
    private, new = tmp_path / "private", tmp_path / "new"
    private.touch(mode=0o640)
    with OutputFile(private) as file:
        file.stream.write(b"secret")
        assert stat.S_IMODE((tmp_path / "private.part").stat().st_mode) == 0o640
    assert stat.S_IMODE(private.stat().st_mode) == 0o640
    before = os.umask(0o027)
    try:
        write_file(new, b"")
    finally:
        os.umask(before)
    assert stat.S_IMODE(new.stat().st_mode) == 0o640


@pytest.mark.parametrize(("error", "left"), [(ValueError, []), (KeyboardInterrupt, ["a.part", "b.part"])])
def test_files_that_belong_together_appear_together_or_not_at_all(
    tmp_path: Path, error: type[BaseException], left: list[str]
) -> None:
    (tmp_path / "a").write_text("former")
    with pytest.raises(error) as caught, Outputs() as outputs:
        _write_and_end(outputs, tmp_path, error)
    assert names(tmp_path) == sorted(["a", *left])
    assert (tmp_path / "a").read_text() == "former"
    notes = [f"what was written until then is in {tmp_path / name}" for name in left]
    assert getattr(caught.value, "__notes__", []) == notes
    for name in left:
        assert (tmp_path / name).read_text() == "new"
    with Outputs() as outputs:  # what was left is no hindrance
        for name in ("a", "b"):
            outputs.open(tmp_path / name).stream.write(b"whole")
    assert names(tmp_path) == ["a", "b"]
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "whole"


def _write_and_end(outputs: Outputs, folder: Path, error: type[BaseException]) -> None:
    for name in ("a", "b"):
        outputs.open(folder / name).stream.write(b"new")
    outputs.open(folder / "nothing yet")
    raise error


def test_a_disk_that_fails_leaves_the_former_content(tmp_path: Path) -> None:
    """Whichever of several files is the one that does not fit."""
    program = f"""
import resource, signal
from pathlib import Path
from candaemon.errors import InputError
from candaemon.files.outputs import Outputs
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    with Outputs() as outputs:
        outputs.open(Path({str(tmp_path)!r}, "small")).stream.write(b"x" * 900)
        outputs.open(Path({str(tmp_path)!r}, "large")).stream.write(b"x" * 1100)
except InputError as error:
    print(error)
"""
    (tmp_path / "small").write_text("former")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == f"{tmp_path / 'large'}: cannot be written: File too large; choose another path\n"
    assert names(tmp_path) == ["small"]
    assert (tmp_path / "small").read_text() == "former"


def test_a_file_that_cannot_get_its_name_is_kept_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a container has one file mounted: it can be written, and not be replaced."""
    monkeypatch.setattr(Path, "replace", lambda _part, target: target.rmdir())
    (tmp_path / "mounted").touch()
    with pytest.raises(InputError, match=rf"mounted: cannot be replaced: .*is in {tmp_path}/mounted\.part"):
        write_file(tmp_path / "mounted", "new")
    assert (tmp_path / "mounted.part").read_text() == "new"


@pytest.mark.parametrize("way", ["itself", "symlink", "hard link", "another spelling", "its part"])
@pytest.mark.parametrize("role", ["read", "written"])
def test_what_is_read_or_written_already_is_refused(tmp_path: Path, way: str, role: str) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.write_text("former")
    match way:
        case "itself":
            second = first
        case "symlink":
            second.symlink_to(first)
        case "hard link":
            second.hardlink_to(first)
        case "another spelling":
            (tmp_path / "folder").mkdir()
            second = tmp_path / "folder" / ".." / "first"
        case _:
            first, second = tmp_path / "first.part", tmp_path / "first"
            first.write_text("former")
    with pytest.raises(ConfigError, match="the file is named twice"):
        _use(first, second, role)
    assert first.read_text() == "former"


def _use(first: Path, second: Path, role: str) -> None:
    with Outputs([first] if role == "read" else []) as outputs:
        if role == "written":
            outputs.open(first)
        outputs.open(second)


def test_two_processes_do_not_write_one_file(tmp_path: Path) -> None:
    path, part = tmp_path / "a", tmp_path / "a.part"
    part.touch()
    with part.open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(InputError, match=r"a: cannot be written: it is being written already"):
            write_file(path, "new")
    write_file(path, "new")
    assert names(tmp_path) == ["a"]


def test_a_link_or_a_folder_in_the_place_of_the_part_is_left_alone(tmp_path: Path) -> None:
    victim, part = tmp_path / "victim", tmp_path / "a.part"
    victim.write_text("former")
    for kind in ("link", "folder", "pipe"):
        match kind:
            case "link":
                part.symlink_to(victim)
            case "folder":
                part.mkdir()
            case _:
                os.mkfifo(part)
        with pytest.raises(InputError, match=r"a\.part is in the way; remove it"):
            write_file(tmp_path / "a", "new")
        part.rmdir() if part.is_dir() else part.unlink()
    assert victim.read_text() == "former"


def test_a_write_protected_file_is_not_replaced(tmp_path: Path) -> None:
    """Renaming would ask for no right to the file itself."""
    path = tmp_path / "protected"
    path.write_text("former")
    path.chmod(0o444)
    tmp_path.chmod(0o777)
    program = f"import os; os.setuid(65534); from pathlib import Path; write_file(Path({str(path)!r}), 'new')"
    loaded = f"from candaemon.files.outputs import write_file; {program}"
    if os.geteuid() != 0:
        loaded = loaded.replace("os.setuid(65534)", "0")
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=False)
    assert "Permission denied" in done.stderr
    assert path.read_text() == "former"
    assert names(tmp_path) == ["protected"]


def test_another_users_link_to_nothing_is_not_followed(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can make another user's link")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    os.chown(tmp_path / "link", 65534, 65534, follow_symlinks=False)
    with pytest.raises(InputError, match="another user's link"):
        write_file(tmp_path / "link", "new")
    assert names(tmp_path) == ["link"]


def test_what_is_no_regular_file_is_written_straight_and_stays_what_it_is(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    reader = subprocess.Popen(["cat", str(fifo)], stdout=subprocess.PIPE)
    with Outputs() as outputs:
        for path in (fifo, Path(os.devnull), Path(os.devnull)):
            outputs.open(path).stream.write(b"text")
    assert reader.communicate()[0] == b"text"
    assert fifo.is_fifo()
    assert Path(os.devnull).is_char_device()
    assert names(tmp_path) == ["fifo"]


def test_a_descriptor_of_the_process_shares_its_place_and_is_not_emptied(tmp_path: Path) -> None:
    (tmp_path / "all").write_text("former\n")
    (tmp_path / "link").symlink_to("/dev/stdout")
    program = f"""
from pathlib import Path
from candaemon.files.outputs import write_file
print("before", flush=True)
for name in ("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", {str(tmp_path / "link")!r}):
    write_file(Path(name), name[:8] + "\\n")
print("behind")
"""
    with (tmp_path / "all").open("a") as stdout:
        subprocess.run([sys.executable, "-c", program], stdout=stdout, check=True)
    written = ["former", "before", "/dev/std", "/dev/fd/", "/proc/se", str(tmp_path)[:8], "behind"]
    assert (tmp_path / "all").read_text().splitlines() == written
    assert names(tmp_path) == ["all", "link"]


def test_what_cannot_be_written_is_named_at_once(tmp_path: Path) -> None:
    file, loop = tmp_path / "file", tmp_path / "loop"
    file.touch()
    loop.symlink_to(loop)
    for path in (tmp_path, tmp_path / "no" / "a.json", file / "a.json", loop, tmp_path / ("x" * 255)):
        with pytest.raises(InputError, match=f"{path}: cannot be written"):
            Outputs().open(path)
    for folder in (file / "plots", file):
        with pytest.raises(InputError, match=f"{folder}: cannot be written"):
            make_folder(folder)
    assert names(tmp_path) == ["file", "loop"]


def test_a_folder_without_the_right_to_write_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)  # root has every right
    with pytest.raises(InputError, match="no right to write"):
        make_folder(tmp_path)


def test_a_folder_is_made_with_those_above_it(tmp_path: Path) -> None:
    for _ in range(2):
        make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
