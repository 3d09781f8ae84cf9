"""Coverage-guided fuzzing with atheris, for long; the normal tests run the same bodies for a moment.

    pip install atheris
    python -m fuzz sdo_server [-max_total_time=3600 and whatever else libFuzzer takes]
    python -m fuzz show crash-...
    python -m fuzz keep sdo_server
    python -m fuzz sdo_clients 100000 [SEED]
    python -m fuzz blocking_threads|copied_frames|damaged_recordings|flash_lives|lossy_restores [FIRST [COUNT]]

The last two lines need no atheris: these programs draw as many cases as they are told.

`python -m fuzz.mutants` plants bugs and says whether the inputs below and the tests find them.

A run begins with fuzz/corpus/TARGET, written by people, and fuzz/kept/TARGET.zip. What is new goes to fuzz/found/TARGET, which is
not in the repository; `keep` makes it the archive.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Final

from fuzz.kept import HERE, keep, kept, unpack

PROGRAMS: Final = ("blocking_threads", "copied_frames", "damaged_recordings", "flash_lives", "lossy_restores")


def main(arguments: list[str]) -> int:
    """The exit status: 0, or 2 where it could not begin."""
    if len(arguments) == 2 and arguments[0] == "show":
        from fuzz.steps import decode, text_of

        print(text_of(decode(Path(arguments[1]).read_bytes())))
        return 0
    if len(arguments) in (2, 3) and arguments[0] == "sdo_clients" and arguments[1].isdecimal():
        from fuzz.sdo_clients import many

        return many(int(arguments[1]), "".join(arguments[2:]) or "0")
    if arguments and arguments[0] in PROGRAMS:
        program = importlib.import_module(f"fuzz.{arguments[0]}")
        status: int = program.main(arguments[1:])
        return status
    names = sorted(path.name for path in (HERE / "corpus").iterdir())
    if len(arguments) == 2 and arguments[0] == "keep" and arguments[1] in names:
        found = HERE / "found" / arguments[1]
        keep(arguments[1], [path.read_bytes() for path in found.iterdir()] if found.exists() else kept(arguments[1]))
        return 0
    if not arguments or arguments[0] not in names:
        print(f"usage: python -m fuzz {{{','.join(names)}}} [libFuzzer options]")
        print("       python -m fuzz show FILE | keep TARGET | sdo_clients COUNT [SEED]")
        print(f"       python -m fuzz {{{','.join(PROGRAMS)}}} [FIRST [COUNT]]")
        return 2
    try:
        import atheris
    except ImportError:
        print("atheris is not installed: 'pip install atheris' (Linux); tests/core/test_fuzz_corpus.py runs the same bodies")
        return 2
    with atheris.instrument_imports(include=["canopen_proto"]):
        from fuzz.targets import TARGETS

    name, *options = arguments
    found = HERE / "found" / name
    found.mkdir(parents=True, exist_ok=True)
    unpack(name, found)
    atheris.Setup([sys.argv[0], *options, str(found), str(HERE / "corpus" / name)], TARGETS[name])
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
