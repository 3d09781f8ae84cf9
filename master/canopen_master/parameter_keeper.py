"""Keeps what simulated devices store by 0x1010: in memory, and in a file so that it outlives the simulation.

The file is JSON, by node-ID and object, bytes as SDO carries them:

    {"format": "canopen-sim-state 1", "devices": {"5": {"1017:00": "E803", "607F:00": "102700000"}}}

The file is read once. It is written whole whenever a device stores or restores. Devices that are not simulated this time keep
their entries.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from canopen_master.whole_file import whole_file
from canopen_proto.explained import Explained
from canopen_proto.multiplexer import Mux, index_of, mux, subindex_of

FORMAT: Final = "canopen-sim-state 1"
MAX_FILE_SIZE: Final = 16 * 1024 * 1024
"""Bytes: 127 devices with thousands of parameters each. A larger file is not ours."""

_OBJECT: Final = re.compile("([0-9A-Fa-f]{4}):([0-9A-Fa-f]{2})")


class StateFileError(Explained, Exception):
    """The file is not one of stored parameters. For the fields see Explained."""

    def __init__(self, path: Path, seen: str) -> None:
        tries = ("name another file: a new one is written when a device stores",)
        super().__init__("CO333", f"{path} is not a state file", seen=seen, tries=tries)


class ParameterKeeper:
    """Keeps the bytes of parameters by node-ID and mux. path: the file; None for memory only."""

    def __init__(self, path: Path | None = None) -> None:
        """Read the file, if there is one. Raises StateFileError if it is not ours, OSError if it cannot be read."""
        self._path = path
        self._kept: dict[int, dict[Mux, bytes]] = {}
        if path is not None and path.exists():
            if path.stat().st_size > MAX_FILE_SIZE:
                raise StateFileError(path, f"it has more than {MAX_FILE_SIZE} bytes")
            self._kept = _parse(path, path.read_bytes())

    def kept(self, node_id: int) -> dict[Mux, bytes] | None:
        """Return the parameters that a device has stored, for `ParameterStorage.load`; None if it has stored none."""
        return self._kept.get(node_id)

    def keep(self, node_id: int, parameters: Mapping[Mux, bytes]) -> None:
        """Keep these parameters of a device in place of its old ones. Raises OSError, with nothing changed, if that fails."""
        after = {**self._kept, node_id: dict(parameters)}
        if self._path is not None:
            with whole_file(self._path) as file:
                file.write(_text(after).encode())
        self._kept = after


def _text(kept: Mapping[int, Mapping[Mux, bytes]]) -> str:
    devices = {
        str(node_id): {
            f"{index_of(mux):04X}:{subindex_of(mux):02X}": data.hex().upper() for mux, data in sorted(parameters.items())
        }
        for node_id, parameters in sorted(kept.items())
    }
    return json.dumps({"format": FORMAT, "devices": devices}, indent=1) + "\n"


def _parse(path: Path, content: bytes) -> dict[int, dict[Mux, bytes]]:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise StateFileError(path, f"it is not JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise StateFileError(path, f'it does not say "format": "{FORMAT}"')
    devices = document.get("devices")
    try:
        return {int(node_id): dict(map(_parameter, entries.items())) for node_id, entries in devices.items()}  # type: ignore[union-attr]
    except (AttributeError, TypeError, ValueError) as error:
        raise StateFileError(path, f"its devices are not valid: {error}") from None


def _parameter(entry: tuple[str, str]) -> tuple[Mux, bytes]:
    match = _OBJECT.fullmatch(entry[0])
    if match is None:
        raise ValueError(f"{entry[0]!r} is not an object")
    return mux(int(match[1], 16), int(match[2], 16)), bytes.fromhex(entry[1])
