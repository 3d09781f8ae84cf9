"""The bodies of the fuzz targets on their saved corpus, and on a bounded number of seeded random inputs."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

from fuzz.__main__ import HERE, main
from fuzz.kept import keep, kept, unpack
from fuzz.steps import OWN_CAN_IDS, decode, encode, text_of
from fuzz.targets import TARGETS

CORPUS = {path.name: sorted(path.iterdir()) for path in sorted((HERE / "corpus").iterdir())}
SAVED = [(target, path) for target, paths in CORPUS.items() for path in paths]
RANDOM_INPUTS = 60


def test_each_target_has_a_corpus() -> None:
    assert set(CORPUS) == set(TARGETS)
    assert all(CORPUS.values())


@pytest.mark.parametrize(("target", "path"), SAVED, ids=[f"{target}-{path.name}" for target, path in SAVED])
def test_saved_inputs(target: str, path: Path) -> None:
    TARGETS[target](path.read_bytes())


@pytest.mark.thorough(6)
@pytest.mark.parametrize("target", TARGETS)
def test_inputs_kept_from_long_runs(target: str) -> None:
    for data in kept(target):
        TARGETS[target](data)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("target", TARGETS)
def test_random_inputs(target: str) -> None:
    source = random.Random(target)
    for _ in range(RANDOM_INPUTS):
        TARGETS[target](source.randbytes(source.randrange(400)))


@pytest.mark.thorough(6)
@pytest.mark.parametrize("target", TARGETS)
def test_saved_inputs_joined_and_damaged(target: str) -> None:
    source = random.Random(target)
    saved = [path.read_bytes() for path in CORPUS[target]]
    for _ in range(RANDOM_INPUTS):
        data = bytearray(b"".join(source.choices(saved, k=source.randrange(1, 6))))
        for _ in range(source.randrange(6)):
            place = source.randrange(len(data))
            match source.randrange(3):
                case 0:
                    data[place] = source.randrange(256)
                case 1:
                    data[place] ^= 1 << source.randrange(8)
                case _:
                    del data[place : place + source.randrange(4)]
            data += b"\x00"
        TARGETS[target](bytes(data))


STEPS = """\
605#4000100000000000
585#4B
205#0700
00000605#00
123#R4
1FFFFFFF#R
wait 0.1 ms
wait 6553.5 ms
wait 200000 ms
act 513"""


def test_steps_as_text_and_back() -> None:
    assert text_of(decode(encode(STEPS))) == STEPS
    assert encode("") == b""
    assert len({str(frame) for can_id in OWN_CAN_IDS for frame in decode(encode(f"{can_id:03X}#01"))}) == len(OWN_CAN_IDS)


def test_bytes_that_end_in_the_middle_of_a_step() -> None:
    assert text_of(decode(b"\x02")) == "605#0000000000000000"
    assert text_of(decode(b"\x00\x04\x02\x07")) == "205#0700"


def test_what_was_found_is_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("fuzz.kept.HERE", tmp_path)
    monkeypatch.setattr("fuzz.__main__.HERE", tmp_path)
    (tmp_path / "corpus" / "sdo_client").mkdir(parents=True)
    found = tmp_path / "found" / "sdo_client"
    found.mkdir(parents=True)
    for number in range(3):
        (found / str(number)).write_bytes(bytes([number // 2]))
    assert main(["keep", "sdo_client"]) == 0
    archive = (tmp_path / "kept" / "sdo_client.zip").read_bytes()
    again = tmp_path / "again"
    again.mkdir()
    unpack("sdo_client", again)
    assert sorted(path.read_bytes() for path in again.iterdir()) == [b"\x00", b"\x01"]
    keep("sdo_client", kept("sdo_client"))
    assert (tmp_path / "kept" / "sdo_client.zip").read_bytes() == archive
    assert main(["keep", "nothing"]) == 2


def test_the_command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    crash = tmp_path / "crash"
    crash.write_bytes(encode(STEPS))
    assert main(["show", str(crash)]) == 0
    assert capsys.readouterr().out == STEPS + "\n"
    assert main([]) == 2
    assert "local_node" in capsys.readouterr().out
    monkeypatch.setitem(sys.modules, "atheris", None)
    assert main(["local_node"]) == 2
    assert "atheris is not installed" in capsys.readouterr().out
