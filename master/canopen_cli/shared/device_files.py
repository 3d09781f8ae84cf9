"""The option -e: the devices' own files (EDS, DCF, XDD, XDC), which name and type their objects in place of the data files.

`-e FILE` is for all nodes, `-e 5=FILE` for node 5 only. Several files given without a node-ID must contain one, as a DCF or an
XDC does. The names of the data files are laid over each, so that `statusword` works with every drive.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_cli.shared.options import node_id_of
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen
from canopen_proto.dictionary import ObjectDictionary

if TYPE_CHECKING:
    from canopen_data.description import DeviceDescription

_OF_NODE: Final = re.compile(r"(0[xX][0-9A-Fa-f]+|[0-9]+)=(.+)")

DeviceFiles: TypeAlias = "Mapping[int | None, DeviceDescription]"
"""Descriptions by node-ID; under None the one for all other nodes."""


def description_of(files: DeviceFiles, node_id: int) -> DeviceDescription | None:
    """Return the description of a node, or None."""
    return files.get(node_id, files.get(None))


def read_device_files(texts: Sequence[str], names: ObjectDictionary, screen: Screen, encoding: str = "") -> DeviceFiles:
    """Read the files of the options -e. names: the dictionary of the data files. encoding: of the files, "" for a guess.

    Tells how many errors a file has. Raises DataError if a file cannot be read; a CommandError if it describes nothing, or if its
    node is not clear.
    """
    files: dict[int | None, DeviceDescription] = {}
    if not texts:
        return files
    from canopen_data.descriptions import with_names  # the readers are imported only if there is a file

    named = [split_file(text) for text in texts]
    without = sum(1 for node_id, _ in named if node_id is None)
    for node_id, path in named:
        description = with_names(_read(path, screen, encoding), names)
        if node_id is None and without > 1:
            node_id = description.node_id
            if node_id is None:
                tries = (f"-e 5={path}    (it is the file of node 5)",)
                raise usage("CO126", f"there are several files, and {path} names no node-ID", tries=tries)
        if node_id in files:
            whose = "all nodes" if node_id is None else f"node {node_id}"
            raise usage("CO126", f"there are two files of {whose}: {files[node_id].source} and {path}")
        files[node_id] = description
    return files


def split_file(text: str) -> tuple[int | None, str]:
    """Return node-ID and path of a text such as "5=drive.eds"; None if it names no node-ID."""
    match = _OF_NODE.fullmatch(text)
    return (None, text) if match is None else (node_id_of(match[1]), match[2])


def _read(path: str, screen: Screen, encoding: str) -> DeviceDescription:
    from canopen_cli.shared.eds_files import tell_faults
    from canopen_data.named_files import open_description

    file = open_description(path, encoding)
    tell_faults(screen, file)
    return file.description
