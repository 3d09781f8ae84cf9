"""`NodeFiles`: what describes each node of the bus: its file by -e, else its entry in the machine file, else the data files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_cli.shared.device_files import DeviceFiles, description_of, read_device_files
from canopen_cli.shared.options import Settings
from canopen_cli.shared.screen import Screen, escape
from canopen_data import load_dictionary
from canopen_data.findings import Severity
from canopen_proto.dictionary import ObjectDictionary

if TYPE_CHECKING:
    from canopen_data.description import DeviceDescription


class NodeFiles:
    """The files of the nodes on the bus of the options, with the side files of --overlay over them.

    A file of the machine is read when its node is asked for. Raises DataError, DictionaryError, CommandError for one that cannot
    be used.
    """

    def __init__(self, settings: Settings, screen: Screen) -> None:
        self.settings = settings
        self._screen = screen
        names = read_dictionary(screen)
        self._own: DeviceFiles = {
            node_id: self._laid_over(each)
            for node_id, each in read_device_files(settings.eds, names, screen, settings.encoding).items()
        }
        self.dictionary = overlaid(names, settings.overlays, screen)
        self._made: dict[int, tuple[DeviceDescription | None, ObjectDictionary]] = {}
        self.machine, self.bus = settings.machine_on_bus()
        if self.machine is not None:
            from canopen_master.machine_file.dictionaries import Dictionaries

            self._dictionaries = Dictionaries(self.machine, names)

    @property
    def of_all_others(self) -> ObjectDictionary:
        """The dictionary of the nodes without a file of their own: of the file that was given for all, or else the data files."""
        for_all = self._own.get(None)
        return self.dictionary if for_all is None else for_all.dictionary

    @property
    def node_ids(self) -> tuple[int, ...]:
        """The nodes that were given a file of their own (-e)."""
        return tuple(node_id for node_id in self._own if node_id is not None)

    def description_of(self, node_id: int) -> DeviceDescription | None:
        """Return what a node's own file says; None for a node without a file."""
        own = description_of(self._own, node_id)
        return self._of_machine(node_id)[0] if own is None else own

    def dictionary_of(self, node_id: int) -> ObjectDictionary:
        """Return the dictionary of a node: that of its own file, or else of the data files. The same object each time."""
        own = description_of(self._own, node_id)
        return self._of_machine(node_id)[1] if own is None else own.dictionary

    def _of_machine(self, node_id: int) -> tuple[DeviceDescription | None, ObjectDictionary]:
        if node_id not in self._made:
            node = None if self.machine is None else self.machine.node_at(self.bus, node_id)
            if node is None:
                return None, self.dictionary
            description = self._dictionaries.description_of(node)
            dictionary = overlaid(self._dictionaries.of(node), self.settings.overlays, self._screen)
            self._made[node_id] = None if description is None else replace(description, dictionary=dictionary), dictionary
        return self._made[node_id]

    def _laid_over(self, description: DeviceDescription) -> DeviceDescription:
        return replace(description, dictionary=overlaid(description.dictionary, self.settings.overlays, self._screen))


def read_dictionary(screen: Screen) -> ObjectDictionary:
    """Read the object dictionary. Tells if a user's own file is used; with -v also warnings about it."""
    dictionary, findings = load_dictionary()
    for finding in findings:
        if finding.severity is Severity.NOTICE:
            screen.say(f"[dim]{escape(finding.source)}: {escape(finding.message)}[/]")
        else:
            screen.detail(str(finding))
    return dictionary


def overlaid(dictionary: ObjectDictionary, paths: Iterable[str], screen: Screen) -> ObjectDictionary:
    """Return the dictionary with these side files laid over it, the later over the earlier.

    With -v, names without an object are told.

    Raises DataError if a file cannot be read, DictionaryError for its faults.
    """
    for path in paths:
        from canopen_data.named_files import read_text
        from canopen_data.overlay import lay_over

        dictionary, findings = lay_over(dictionary, read_text(Path(path)), path)
        for finding in findings:
            screen.detail(str(finding))
    return dictionary
