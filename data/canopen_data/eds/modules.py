"""Make the objects of the modules that are connected to a modular device.

A modular device, such as a bus coupler, describes each type of module in the sections of [SupportedModules]. In a DCF,
[ConnectedModules] names the module in each slot. A connected module adds

- fixed objects ([MxFixedObjects], [MxFixed6423], [MxFixed6423sub1]): once, however many modules of the type there are;
- entries of an array ([MxSubExtends], [MxSubExt6000]), slot by slot. Count=2 adds two entries. Count=0;4 adds four bits: an entry
  is shared with the next modules until its type is full. With ObjExtend=128, the next index follows after subindex 128.

A file that was written after the modules were connected has sections for their objects. So what the file itself describes stays
as it is: a fixed object with a section, and an array that has at least as many entries as the modules add. Else the modules'
entries go behind those of the file. An entry has the name of its section with the subindex added (`%n` stands for the number).

Whatever cannot be made is an error: an unknown module, a Count that makes no sense, no room. Without [ConnectedModules] there is
a notice: nobody has said what is connected, so the objects of modules are not in the dictionary.

Source: CiA 306-1 v1.4.0, 8.2 and 8.3 (modular devices), as other tools implement it; EdsDcfNet has the bits of `Count=0;4`, too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

from canopen_data.description import Module
from canopen_data.eds.compact import MAX_SUBINDEX, Compact
from canopen_data.eds.device import module_extensions
from canopen_data.eds.ini import EdsDocument, Findings, Section, quoted
from canopen_data.eds.numbers import read_number
from canopen_data.eds.variables import Variables
from canopen_data.findings import Severity
from canopen_proto.datatypes import DataType, bit_length_of
from canopen_proto.dictionary.objects import Access, Object, ObjectType, Variable

_FIXED: Final = re.compile(r"m([0-9]{1,6})fixed(?:obj)?([0-9a-f]{1,4})(?:sub([0-9a-f]{1,2}))?", re.ASCII)
_COUNT: Final = re.compile(r"(\S+?)\s*(?:;\s*(\S+))?")
_OWN_KEYS: Final = ("count", "objextend")
_NUMBER_IN_NAME: Final = "%n"
_EXTENDED: Final = (ObjectType.ARRAY, ObjectType.RECORD)


@dataclass(slots=True)
class _Extension:
    """What each module of a type adds to an object. count: entries. bits: of a shared entry; 0 = none. last: the highest subindex
    before the next index is used; 0 = there is no next one."""

    section: Section
    like: Variable
    count: int
    bits: int
    last: int


@dataclass(slots=True)
class _Place:
    """Where the next entry of an extended object goes. index: of the object, or of one that follows it. free: bits of its last
    entry that nobody has taken. made: its entries from modules, by index."""

    index: int
    highest: int
    free: int
    made: dict[int, dict[int, Variable]]


class Modules:
    """The maker of the modules' objects. objects: those of the file, by index; new ones are put there."""

    def __init__(
        self,
        document: EdsDocument,
        variables: Variables,
        compact: Compact,
        findings: Findings,
        objects: dict[int, Object],
        read_object: Callable[[Section, int, dict[int, Section]], Object],
    ) -> None:
        self._document = document
        self._variables = variables
        self._compact = compact
        self._findings = findings
        self._objects = objects
        self._read_object = read_object
        self._sections = module_extensions(document)
        self._extensions: dict[tuple[int, int], _Extension | None] = {}

    def connect(self, modules: tuple[Module, ...], slots: tuple[int, ...], *, is_expanded: bool) -> None:
        """Add the objects of the modules in the slots. slots: the module's number, 0 for an empty slot. is_expanded: the file may
        have sections for the entries that modules add."""
        known = {module.number: module for module in modules}
        adding = [module for module in modules if module.fixed_objects or module.sub_extensions]
        if adding and not slots:
            message = f"{len(adding)} types of modules, and no [ConnectedModules]: objects of modules are not in the dictionary"
            self._tell(self._document.named.get("supportedmodules"), Severity.NOTICE, message)
        connected = []
        for slot, number in enumerate(slots, start=1):
            if number in known:
                connected.append(known[number])
            elif number:
                message = f"slot {slot} holds module {number}, which the file does not describe; its objects are missing"
                self._tell(self._document.named.get("connectedmodules"), Severity.ERROR, message, str(slot))
        self._add_fixed({module.number for module in connected})
        self._extend(connected, is_expanded)

    # ---- fixed objects ----

    def _add_fixed(self, numbers: Iterable[int]) -> None:
        whole: dict[tuple[int, int], Section] = {}
        subs: dict[tuple[int, int], dict[int, Section]] = {}
        for name, section in self._document.named.items():
            if found := _FIXED.fullmatch(name):
                key = int(found[1]), int(found[2], 16)
                if found[3] is None:
                    whole[key] = section
                else:
                    subs.setdefault(key, {})[int(found[3], 16)] = section
        for (number, index), section in whole.items():
            if number in numbers and index not in self._objects and self._compact.may_make(1, section.line):
                self._objects[index] = self._read_object(section, index, subs.get((number, index), {}))

    # ---- entries of arrays ----

    def _extend(self, connected: list[Module], is_expanded: bool) -> None:
        places: dict[int, _Place] = {}
        refused = self._complete(connected, is_expanded)
        for module in connected:
            for index in module.sub_extensions:
                extension = self._extension(module.number, index)
                if extension is None or index in refused:
                    continue
                place = places.get(index)
                if place is None:
                    place = places[index] = _Place(index, self._highest(index), 0, {})
                if not self._add(place, extension):
                    refused.add(index)
        for place in places.values():
            for index, entries in place.made.items():
                self._objects[index] = self._extended(index, entries)

    def _complete(self, connected: list[Module], is_expanded: bool) -> set[int]:
        """Return the objects that need no entries of modules: the file has them, or cannot have any."""
        wanted: dict[int, float] = {}
        last: dict[int, int] = {}
        for module in connected:
            for index in module.sub_extensions:
                if (extension := self._extension(module.number, index)) is not None:
                    share = extension.bits / (bit_length_of(extension.like.data_type) or 1)
                    wanted[index] = wanted.get(index, 0) + extension.count + share
                    last[index] = extension.last
        complete = set()
        for index, entries in wanted.items():
            own = self._objects.get(index)
            if own is None:
                continue
            if own.object_type not in _EXTENDED:
                section = self._document.objects.get(index)
                message = (
                    f"[{index:04X}] is a {own.object_type.name}: modules cannot add entries to it; their entries are missing"
                )
                self._tell(section, Severity.ERROR, message, "ObjectType")
                complete.add(index)
            elif is_expanded and entries and (had := self._entries_from(index, last[index])) >= entries:
                message = f"[{index:04X}] has {had} entries already: those of its modules are taken to be among them"
                self._tell(self._document.objects.get(index), Severity.NOTICE, message)
                complete.add(index)
        return complete

    def _entries_from(self, index: int, last: int) -> int:
        """Return how many entries an object has, together with those that follow it."""
        count = 0
        while (own := self._objects.get(index)) is not None:
            entries = [subindex for subindex in own.variables if 0 < subindex <= MAX_SUBINDEX]
            count += len(entries)
            if not last or len(entries) < last:
                break
            index += 1
        return count

    def _highest(self, index: int) -> int:
        own = self._objects.get(index)
        return 0 if own is None else max((each for each in own.variables if each <= MAX_SUBINDEX), default=0)

    def _extension(self, number: int, index: int) -> _Extension | None:
        """Return what a module adds to an object; None, with an error the first time, if that makes no sense."""
        key = number, index
        if key not in self._extensions:
            self._extensions[key] = self._read_extension(self._sections[number][index], index)
        return self._extensions[key]

    def _read_extension(self, section: Section, index: int) -> _Extension | None:
        text = section.get("Count") or ""
        found = _COUNT.fullmatch(text)
        count, bits = (None if each is None else read_number(each)[0] for each in found.groups()) if found else (None, None)
        has_bits = found is not None and found[2] is not None
        object_type = read_number(section.get("ObjectType") or "7")[0]
        last = read_number(section.get("ObjExtend") or "0")[0]
        fault, field = "", "Count"
        if object_type != ObjectType.VAR:
            fault, field = (
                f"ObjectType={quoted(section.get('ObjectType') or '')}: only a VAR can be added as an entry",
                "ObjectType",
            )
        elif last is None or not 0 <= last <= MAX_SUBINDEX:
            fault, field = f"ObjExtend={quoted(section.get('ObjExtend') or '')} is not 0..{MAX_SUBINDEX}", "ObjExtend"
        elif count is None or count < 0 or (has_bits and (count or not bits or bits < 0)):
            fault = f"Count={quoted(text)} is neither a number of entries nor 0;bits" if text else "Count is missing"
        like = self._variables.read(section.without(_OWN_KEYS), index, 1)
        if not fault and has_bits and (bits or 0) > (bit_length_of(like.data_type) or 0):
            fault = f"Count={quoted(text)}: a {like.data_type.name} does not have so many bits"
        if fault:
            self._tell(section, Severity.ERROR, f"{fault}; the module's entries of [{index:04X}] are missing", field)
            return None
        return _Extension(section, like, count or 0, bits or 0, last or 0)

    def _add(self, place: _Place, extension: _Extension) -> bool:
        """Add a module's entries. False, with an error, if there is no room."""
        if extension.bits and place.free >= extension.bits:
            place.free -= extension.bits
            return True
        if extension.bits:
            place.free = (bit_length_of(extension.like.data_type) or 0) - extension.bits
        else:
            place.free = 0
        for _ in range(extension.count or bool(extension.bits)):
            if extension.last and place.highest >= extension.last:
                place.index += 1
                place.highest = self._highest(place.index)
            if place.highest >= MAX_SUBINDEX or place.index > 0xFFFF:
                message = f"there is no subindex left in [{place.index:04X}]; entries of modules are missing"
                self._tell(extension.section, Severity.ERROR, message, "Count")
                return False
            if not self._compact.may_make(1, extension.section.line):
                return False
            place.highest += 1
            name, number = extension.like.name, str(place.highest)
            name = name.replace(_NUMBER_IN_NAME, number) if _NUMBER_IN_NAME in name else f"{name} {number}"
            variable = replace(extension.like, index=place.index, subindex=place.highest, name=name)
            place.made.setdefault(place.index, {})[place.highest] = variable
        return True

    def _extended(self, index: int, entries: dict[int, Variable]) -> Object:
        """Return the object with these entries, and with its highest subindex in subindex 0."""
        own = self._objects.get(index)
        first = next(iter(entries.values()))
        old = {} if own is None else own.variables
        count = old.get(0, Variable(index, 0, "Highest sub-index supported", DataType.UNSIGNED8, Access.RO))
        if not count.access.writable:
            count = replace(count, default=max(entries), adds_node_id=False)
        variables = dict(sorted({**old, **entries, 0: count}.items()))
        if own is not None:
            return replace(own, variables=MappingProxyType(variables))
        types = {each.data_type for each in entries.values()}
        name = first.name.rpartition(str(first.subindex))[0].strip() or first.name
        if len(types) == 1:
            return Object(index, name, ObjectType.ARRAY, MappingProxyType(variables), int(first.data_type))
        return Object(index, name, ObjectType.RECORD, MappingProxyType(variables))

    def _tell(self, section: Section | None, severity: Severity, message: str, key: str = "") -> None:
        self._findings.in_section(section, key, severity, "modules", message)
