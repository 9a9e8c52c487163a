"""A YAML file that asks for more than a machine has is refused soon, with its line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from candaemon.config.load import load_config
from candaemon.config.yaml_file import LARGEST_FILE
from candaemon.config.yaml_text import (
    LONGEST_KEY,
    LONGEST_NUMBER,
    MOST_LEVELS,
    MOST_NODES,
    read_yaml,
)
from candaemon.errors import MOST_PROBLEMS, ConfigError
from candaemon.similar_names import LONGEST_COMPARED, MOST_COMPARED, MOST_LISTED, listed_names, similar_names
from candaemon.simulation.scenario import load_scenario
from tests.support.memory import PEAK_MIB
from tests.support.paths import ROOT

SOON_S = 10.0
MOST_MB = 400

SENSOR = """\
  front: &front
    bus: radar
    dbc: my_radar.dbc
    cycle_time: 0.05
    objects: {messages: ["Object_{slot}"], slots: 16, valid: [{signal: Valid, in: [1]}]}
    scan: {close: timeout}
    signals: {x: DistX, y: -DistRight, range_rate: Speed}
    noise: {x: 0.2, y: 0.3, range_rate: 0.1}
"""
VEHICLE = f"buses: {{radar: {{channel: can0}}}}\nego: {{kind: static}}\nsensors:\n{SENSOR}"


def repeated(first: str, of: str) -> str:
    """Return nine levels of aliases, each of which repeats the one before nine times."""
    levels = [f"a0: &a0 {first}"]
    levels += [f"a{level}: &a{level} " + of.format(",".join([f"*a{level - 1}"] * 9)) for level in range(1, 9)]
    return "\n".join(levels) + "\n"


LONG = "x" * 100_000
BOMBS = {
    "aliases": (repeated("[x,x,x,x,x,x,x,x,x]", "[{}]"), "keys and values, those that aliases repeat"),
    "merges": (repeated("{x: 1}", "{{<<: [{}]}}"), "keys and values, those that aliases repeat"),
    "nested brackets": ("a: " + "[" * 100_000, "levels of lists"),
    "nested braces": ("a: " + "{a: " * 50_000, "levels of lists"),
    "nested dashes": ("- " * 100_000, "levels of lists"),
    "nested question marks": ("? " * 50_000, "levels of lists"),
    "nested lines": ("".join(" " * level + "a:\n" for level in range(700)), "levels of lists"),
    "decimal number": ("a: " + "9" * 5000, "a number of 5,000 characters"),
    "hexadecimal number": ("a: 0x" + "9" * 5000, "a number of 5,002 characters"),
    "fraction": (f"a: {'9' * 20_000}.0", "a number of 20,002 characters"),
    "version": (f"%YAML 1.{'9' * 5000}\n---\na: 1", "a number that is too large"),
    "escape": ('a: "\\UFFFFFFFF"', "a number that is too large"),
    "tag": (f"a: !{LONG} 1", "found the tag '!xxx"),
    "alias name": (f"a: *{LONG}", "undefined alias 'xxx"),
    "key": (f"? {LONG}\n: 1", "a key of 100,000 characters"),
    "text": (f"buses: {LONG}", "buses: found 'xxx"),
    "unknown keys": ("".join(f"wrong_key_{number}: 1\n" for number in range(5000)), "and 4,953 more"),
    "unknown sensors": (
        VEHICLE + "groups: {g: {sensors: [" + ",".join(f"fron{number}" for number in range(9000)) + "]}}",
        "found sensor 'fron0'",
    ),
    "unknown buses": (
        "ego: {kind: static}\nbuses:\n"
        + "".join(f"  {number:040d}: {{channel: c{number}}}\n" for number in range(1000))
        + f"sensors:\n{SENSOR}"
        + "".join(f"  s{number}: {{<<: *front, bus: x{number:040d}}}\n" for number in range(60)),
        "and 970 more",
    ),
    "names without quotes": ("a: [" + "a{slot}" * 37_000 + "'", "not valid YAML"),
    "size": ("# long\n" * 50_000, "longer than 262,144 bytes"),
}
"""What a file holds, and a part of what is said of it."""

IN_A_PROCESS = f"""
import json, resource, sys, time
resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))
from pathlib import Path
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
for name in sys.argv[2:]:
    began_s = time.process_time()
    try:
        load_config(Path(sys.argv[1], name))
    except ConfigError as error:
        said = str(error)
    print(json.dumps([name, time.process_time() - began_s, said]))
print(json.dumps(["", {PEAK_MIB}, ""]))
"""


def refused(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_yaml(path)
    return str(caught.value)


def test_whatever_a_file_asks_for_it_is_refused_soon_in_little_memory_and_few_words(tmp_path: Path) -> None:
    for name, (text, _) in BOMBS.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", IN_A_PROCESS, tmp_path, *BOMBS], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    *told, (_, megabytes, _) = map(json.loads, done.stdout.splitlines())
    assert megabytes < MOST_MB
    assert [name for name, _, _ in told] == list(BOMBS)
    for name, seconds, said in told:
        assert seconds < SOON_S, name
        assert said.startswith(f"{tmp_path / name}:"), said  # with its line after it, but for the size of the whole
        assert BOMBS[name][1] in said, (name, said)
        assert len(said.splitlines()) <= MOST_PROBLEMS + 1, name
        assert len(said) < 100_000, name


def test_a_file_may_be_so_long(tmp_path: Path) -> None:
    path = tmp_path / "long.yaml"
    text = "a: 1\n#"
    path.write_text(text + "x" * (LARGEST_FILE - len(text)), encoding="utf-8")
    assert read_yaml(path)[0] == {"a": 1}
    assert "longer than 262,144 bytes" in refused(path, text + "x" * (LARGEST_FILE - len(text) + 1))


def test_a_file_may_have_so_many_values(tmp_path: Path) -> None:
    path = tmp_path / "many.yaml"
    written = "a: [" + "x," * (MOST_NODES - 3) + "{}]"  # beside the mapping, the key and the list
    path.write_text(written.format(""), encoding="utf-8")
    assert len(read_yaml(path)[0]["a"]) == MOST_NODES - 3
    assert ":1: not valid YAML: more than 20,000 keys" in refused(path, written.format("x"))
    aliases, spare = divmod(MOST_NODES - 102, 100)  # beside the mapping, the first list with its items, and the second
    repeated_list = "a: &a [" + "x," * 99 + "]\nb: [" + "*a," * aliases + "x," * spare + "{}]"
    path.write_text(repeated_list.format(""), encoding="utf-8")
    read_yaml(path)
    assert ":2: more than 20,000 keys" in refused(path, repeated_list.format("x"))


def test_values_may_lie_so_deep(tmp_path: Path) -> None:
    path = tmp_path / "deep.yaml"
    inner = MOST_LEVELS - 2  # beside the file's own mapping and the value
    path.write_text("a: " + "[" * inner + "x" + "]" * inner, encoding="utf-8")
    read_yaml(path)
    assert ":1: not valid YAML: more than 32 levels" in refused(path, "a: " + "[" * 31 + "x" + "]" * 31)
    chain = "".join(f"a{level}: &a{level} [*a{level - 1}]\n" for level in range(1, 32))
    assert "more than 32 levels" in refused(path, f"a0: &a0 x\n{chain}")
    chain = "".join(f"a{level}: &a{level} {{<<: *a{level - 1}}}\n" for level in range(1, 32))
    assert "more than 32 levels" in refused(path, f"a0: &a0 {{}}\n{chain}")


def test_keys_and_numbers_may_be_so_long(tmp_path: Path) -> None:
    path = tmp_path / "long.yaml"
    key, number = "k" * LONGEST_KEY, "1" * LONGEST_NUMBER
    path.write_text(f"{key}: {number}", encoding="utf-8")
    assert read_yaml(path)[0] == {key: int(number)}
    assert ":1: found a key of 201 characters, expected 200 at most" in refused(path, f"{key}k: 1")
    assert ":1: found a number of 101 characters, expected 100 at most" in refused(path, f"a: {number}1")


def test_merged_keys_keep_their_precedence(tmp_path: Path) -> None:
    path = tmp_path / "merged.yaml"
    path.write_text("a: &a {x: 1, y: 1}\nb: &b {x: 2, z: 2}\nc: {<<: [*a, *b], y: 3}\nd: {<<: *b, <<: *a}", "utf-8")
    values, _ = read_yaml(path)
    assert values["c"] == {"x": 1, "y": 3, "z": 2}
    assert values["d"] == {"x": 2, "z": 2, "y": 1}


def test_a_character_that_yaml_does_not_know_is_told_with_its_line(tmp_path: Path) -> None:
    assert refused(tmp_path / "bell.yaml", "a: 1\nb: \a\n").endswith(":2: not valid YAML: the character U+0007")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\x85", "\u2028", "\u2029"])
def test_lines_end_as_they_may_in_yaml(tmp_path: Path, end: str) -> None:
    path = tmp_path / "ends.yaml"
    assert ":4: not valid YAML" in refused(path, end.join(["a: 1", "b: [", "c: d", "e: }", ""]))
    told = refused(path, end.join(["a: 1", "b: {x: TRACK_{slot}", "c: ]"]))
    assert ":2: not valid YAML" in told
    assert told.endswith('; a name with {…} is text in quotes, such as "TRACK_{slot}"')
    assert refused(path, end.join(["a: 1", "b: \a"])).endswith(":2: not valid YAML: the character U+0007")


@pytest.mark.parametrize("count", [MOST_PROBLEMS, MOST_PROBLEMS + 1])
def test_so_many_problems_are_told(tmp_path: Path, count: int) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(VEHICLE + "".join(f"wrong{number}: 1\n" for number in range(count)), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    told = str(caught.value).splitlines()
    assert sum("found an unknown key" in line for line in told) == MOST_PROBLEMS
    assert told[-1].endswith("and 1 more") == (count > MOST_PROBLEMS)


def test_a_scenario_of_many_actors_is_checked_soon(tmp_path: Path) -> None:
    path = tmp_path / "crowd.yaml"
    actors = "".join(f"- {{name: a{number}, start: *s}}\n" for number in range(1200))
    path.write_text(
        f"duration: 1\nego: {{start: &s {{x: 0, y: 0, vx: 1, vy: 0}}}}\nactors:\n{actors}- {{name: a7, start: *s}}",
        encoding="utf-8",
    )
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert len(str(caught.value)) < 20_000


def test_a_name_is_compared_with_so_many_of_so_many_characters() -> None:
    known = [f"{number:08d}" for number in range(MOST_COMPARED)]
    assert similar_names("0000009x", known) == ["00000099"]
    assert similar_names("0000009x", [*["00000000"] * MOST_COMPARED, "00000099"]) == ["00000000"]
    name = "n" * LONGEST_COMPARED
    assert similar_names(name, [name]) == [name]
    assert similar_names(f"{name}n", [name]) == []
    assert similar_names(name, [f"{name}n"]) == []


def test_so_many_names_are_listed() -> None:
    names = [str(number) for number in range(MOST_LISTED + 1)]
    assert listed_names(names[:-1]) == ", ".join(names[:-1])
    assert listed_names(names) == ", ".join(names[:-1]) + " and 1 more"


def test_a_pipe_is_read_as_far_as_a_file(tmp_path: Path) -> None:
    read, write = os.pipe()
    with open(write, "w", encoding="utf-8") as pipe:  # noqa: PTH123 - a descriptor, which `Path` cannot open
        pipe.write("a: 1\n")
    assert read_yaml(Path(f"/dev/fd/{read}"))[0] == {"a": 1}
    os.close(read)
    with pytest.raises(ConfigError, match="longer than 262,144 bytes"):
        read_yaml(Path("/dev/zero"))
