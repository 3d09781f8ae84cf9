"""The dictionaries of a machine's devices: from their own files, with the side files laid over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from canopen_data import DataError, load_dictionary, text_of
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import read_file, with_names
from canopen_data.overlay import lay_over
from canopen_data.reading import read_description
from canopen_master.machine_file.model import MachineFile, NodeEntry
from canopen_proto.dictionary import ObjectDictionary


class Dictionaries:
    """Reads the files of a machine's nodes, each once. Raises DataError, DictionaryError for one that cannot be used."""

    def __init__(self, machine: MachineFile, names: ObjectDictionary | None = None) -> None:
        """names: the dictionary of nodes without a file; its names are laid over the files. None: that of the data files."""
        self._machine = machine
        self.names = load_dictionary()[0] if names is None else names
        self._read: dict[tuple[str, str], DeviceDescription] = {}
        self._laid: dict[tuple[str, str, tuple[str, ...]], ObjectDictionary] = {}

    def description_of(self, node: NodeEntry) -> DeviceDescription | None:
        """Return what the node's own file says, with its names and side files; None for a node without a file."""
        description = self._description(node)
        return None if description is None else replace(description, dictionary=self.of(node))

    def of(self, node: NodeEntry) -> ObjectDictionary:
        """Return the dictionary of a node. It is the same object for all nodes with the same files."""
        description, overlays = self._description(node), node.device.overlays
        dictionary = self.names if description is None else description.dictionary
        if not overlays:
            return dictionary
        key = node.device.file, node.device.encoding, overlays
        if key not in self._laid:
            for name in overlays:
                path = self._machine.path(name)
                dictionary, _ = lay_over(dictionary, _text(path), path)
            self._laid[key] = dictionary
        return self._laid[key]

    def _description(self, node: NodeEntry) -> DeviceDescription | None:
        device = node.device
        if not device.file:
            return None
        key = device.file, device.encoding
        if key not in self._read:
            path = self._machine.path(device.file)
            description = read_description(read_file(path), path, encoding=device.encoding)
            self._read[key] = with_names(description, self.names)
        return self._read[key]


def _text(path: str) -> str:
    text = text_of(Path(path), path)
    if text is None:
        raise DataError(f"there is no file {path!r}", "check the path")
    return text
