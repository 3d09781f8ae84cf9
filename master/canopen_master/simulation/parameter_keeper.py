"""Keeps what simulated devices store by 0x1010 and by LSS: in memory, and in a file so that it outlives the simulation.

The file is JSON, by node-ID and object, bytes as SDO carries them:

    {"format": "canopen-sim-state 1", "devices": {"5": {"1017:00": "E803", "607F:00": "102700000"}}}

LSS adds `"lss": {"255": {"node_id": 5, "bit_rate": 250}}`; a device that is made without a node-ID has 255, further ones count on
from there.

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
from canopen_proto.lss.messages import LssConfiguration, is_node_id
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
        self._lss: dict[int, LssConfiguration] = {}
        if path is not None and path.exists():
            if path.stat().st_size > MAX_FILE_SIZE:
                raise StateFileError(path, f"it has more than {MAX_FILE_SIZE} bytes")
            self._kept, self._lss = _parse(path, path.read_bytes())

    def kept(self, node_id: int) -> dict[Mux, bytes] | None:
        """Return the parameters that a device has stored, for `ParameterStorage.load`; None if it has stored none."""
        return self._kept.get(node_id)

    def keep(self, node_id: int, parameters: Mapping[Mux, bytes]) -> None:
        """Keep these parameters of a device in place of its old ones. Raises OSError, with nothing changed, if that fails."""
        after = {**self._kept, node_id: dict(parameters)}
        self._write(after, self._lss)
        self._kept = after

    def kept_lss(self, node_id: int) -> LssConfiguration | None:
        """Return what a device has stored by LSS; None if it has stored nothing. node_id: the one with which it was made."""
        return self._lss.get(node_id)

    def keep_lss(self, node_id: int, stored: LssConfiguration) -> None:
        """Keep what a device stores by LSS. Raises OSError, with nothing changed, if that fails. node_id: with which the device
        was made. stored: node-ID and bit rate."""
        after = {**self._lss, node_id: stored}
        self._write(self._kept, after)
        self._lss = after

    def _write(self, kept: Mapping[int, Mapping[Mux, bytes]], lss: Mapping[int, LssConfiguration]) -> None:
        if self._path is not None:
            with whole_file(self._path) as file:
                file.write(_text(kept, lss).encode())


def _text(kept: Mapping[int, Mapping[Mux, bytes]], lss: Mapping[int, LssConfiguration]) -> str:
    devices = {
        str(node_id): {
            f"{index_of(mux):04X}:{subindex_of(mux):02X}": data.hex().upper() for mux, data in sorted(parameters.items())
        }
        for node_id, parameters in sorted(kept.items())
    }
    document: dict[str, object] = {"format": FORMAT, "devices": devices}
    if lss:
        document["lss"] = {str(node_id): stored._asdict() for node_id, stored in sorted(lss.items())}
    return json.dumps(document, indent=1) + "\n"


def _parse(path: Path, content: bytes) -> tuple[dict[int, dict[Mux, bytes]], dict[int, LssConfiguration]]:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise StateFileError(path, f"it is not JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise StateFileError(path, f'it does not say "format": "{FORMAT}"')
    devices, lss = document.get("devices"), document.get("lss", {})
    try:
        kept = {int(node_id): dict(map(_parameter, entries.items())) for node_id, entries in devices.items()}  # type: ignore[union-attr]
        stored = {int(node_id): _configuration(entry) for node_id, entry in lss.items()}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise StateFileError(path, f"its devices are not valid: {error}") from None
    return kept, stored


def _configuration(entry: Mapping[str, object]) -> LssConfiguration:
    node_id, bit_rate = entry["node_id"], entry["bit_rate"]
    if not isinstance(node_id, int) or not isinstance(bit_rate, int) or not is_node_id(node_id):
        raise ValueError(f"{dict(entry)!r} is neither node-ID nor bit rate")
    return LssConfiguration(node_id, bit_rate)


def _parameter(entry: tuple[str, str]) -> tuple[Mux, bytes]:
    match = _OBJECT.fullmatch(entry[0])
    if match is None:
        raise ValueError(f"{entry[0]!r} is not an object")
    return mux(int(match[1], 16), int(match[2], 16)), bytes.fromhex(entry[1])
