"""Planted bugs of device files and of the conformance tester. No fuzz target knows them; tests find them.

One more was planted and is believed equivalent: `_lost` of canopen_data/backup_file.py without readings of no bytes at all
(`!= each.data and each.data`). The file holds such a value by _ParameterBytes, so it is never lost.
"""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

NUMBERS: Final = ("tests/data/test_eds_numbers.py",)
INI: Final = ("tests/data/test_eds_ini.py",)
UNUSED: Final = ("tests/data/test_eds_unused.py",)
MODULES: Final = ("tests/data/test_eds_modules.py",)
ENCODINGS: Final = ("tests/data/test_eds_encodings.py",)
BACKUP: Final = ("tests/data/test_backup_file.py",)
XDD: Final = ("tests/data/test_xdd.py",)
RULES: Final = ("tests/data/test_checks_rules.py",)
COB_IDS: Final = ("tests/core/test_cob_ids_without_value.py",)
LATE: Final = ("tests/check/test_conformance_late.py",)
OBJECTS: Final = ("tests/check/test_conformance_objects.py",)

_NUMBERS: Final = "canopen_data/eds/numbers.py"
_MODULES: Final = "canopen_data/eds/modules.py"
_EXPECTATIONS: Final = "canopen_check/expectations.py"
_DICTIONARY: Final = "canopen_check/dictionary_cases.py"

CONFIGURE: Final = ("tests/core/test_configure_pdo.py",)
REWRITTEN: Final = ("tests/core/test_rewritten_pdos.py",)

DATA_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        # ---- numbers, texts and places of an EDS ----
        (
            "octal_ten_unnoticed",
            _NUMBERS,
            "number < 8 else",
            "number < 9 else",
            "010 is read as 8 without a word, though the author may have meant 10",
            NUMBERS,
        ),
        (
            "too_large_is_zero",
            _NUMBERS,
            "if low < 0 and high < number < size:",
            "if low < 0 and high < number <= size:",
            "256 in eight bits is read as 0",
            NUMBERS,
        ),
        (
            "infinity_of_a_number",
            _NUMBERS,
            "value = real_of(text)",
            "value = float(text)",
            "1e400 in a file becomes an infinite set-point without a word",
            NUMBERS,
        ),
        (
            "lost_setting_unnoticed",
            "canopen_data/eds/variables.py",
            'LOST_SETTING if lost else "value"',
            '"value"',
            "a device is set up without a setting of its file, and nobody is told",
            UNUSED,
        ),
        (
            "entry_of_no_sub_object_unnoticed",
            "canopen_data/eds/compact.py",
            "elif not 1 <= subindex <= count:",
            "elif False:",
            "a value in [2000Value] for a subindex that is not there is lost without a word",
            UNUSED,
        ),
        (
            "restored_without_a_setting",
            "canopen_cli/node/restore.py",
            "if description.lost_settings and not forced:",
            "if False:",
            "a device is restored without a setting that the file has, with status 0",
            ("tests/cli/test_backup.py",),
        ),
        (
            "booted_without_a_setting",
            "canopen_master/machine_file/boot_entries.py",
            "if description.lost_settings:",
            "if False:",
            "a node is started without a setting that its file has",
            ("tests/master/test_boot_entries.py",),
        ),
        (
            "comment_loses_the_value",
            _NUMBERS,
            "    if cut is not None and cut.start():\n        reading",
            "    if False:\n        reading",
            "a value with a comment behind it is lost",
            NUMBERS,
        ),
        (
            "comment_cuts_texts",
            _NUMBERS,
            "cut = None if data_type in TEXTS else _COMMENT.search(text)",
            "cut = _COMMENT.search(text)",
            "a text with a semicolon loses its end",
            NUMBERS,
        ),
        (
            "last_key_counts",
            "canopen_data/eds/ini.py",
            "self._places.setdefault(folded, (number, len(line) - len(value.lstrip()) + 1))",
            "self._places[folded] = number, len(line) - len(value.lstrip()) + 1",
            "a finding stands at a line that does not count",
            INI,
        ),
        (
            "encoding_replaces",
            "canopen_data/eds/writer.py",
            'return text.encode("utf-8", "replace")',
            'return text.encode(encoding, "replace")',
            "characters become question marks",
            ENCODINGS,
        ),
        (
            "written_unread",
            "canopen_data/eds/writer.py",
            "    if sections_of(read_eds(text)) == after:\n        return text",
            "    return text",
            "a file that says something else than the description is written",
            MODULES,
        ),
        (
            "xdd_text_left_out",
            "canopen_data/xdd/texts.py",
            "read_value(text if is_text else text.strip(), data_type)",
            'read_value(text if is_text and text.isascii() else "" if is_text else text.strip(), data_type)',
            "a text has another verdict in an XDD than in an EDS",
            XDD,
        ),
        # ---- modules ----
        (
            "bits_never_full",
            _MODULES,
            "if extension.bits and place.free >= extension.bits:",
            "if extension.bits and place.free > extension.bits:",
            "the last bits of an entry are left unused, and all that follows is one subindex further",
            MODULES,
        ),
        (
            "next_index_late",
            _MODULES,
            "if extension.last and place.highest >= extension.last:",
            "if extension.last and place.highest > extension.last:",
            "ObjExtend counts one entry too many",
            MODULES,
        ),
        (
            "fixed_objects_of_all",
            _MODULES,
            "if number in numbers and index not in self._objects",
            "if index not in self._objects",
            "objects of modules that are not connected are in the dictionary",
            MODULES,
        ),
        (
            "entries_doubled",
            _MODULES,
            "self._entries_from(index, last[index])) >= entries:",
            "self._entries_from(index, last[index])) > entries:",
            "a DCF that has the entries gets them once more",
            MODULES,
        ),
        (
            "eds_of_connected_modules",
            "canopen_data/configured.py",
            "        connected_modules=(),\n",
            "",
            "an EDS says which modules one device has",
            MODULES,
        ),
        # ---- findings, backups ----
        (
            "findings_without_bound",
            "canopen_data/checks/__init__.py",
            "if len(found) < MAX_FINDINGS:",
            "if True:",
            "a small file fills the memory with findings",
            RULES,
        ),
        (
            "refused_objects_vanish",
            "canopen_data/backup_file.py",
            "if each.data is not None or each.result.is_missing:",
            "if each.data is not None:",
            "a backup does not name what the device refused to show",
            BACKUP,
        ),
        # ---- COB-IDs without a value ----
        (
            "no_cob_id_is_zero",
            "dictionary/objects.py",
            "            if cob_id is not None:\n                return cob_id\n",
            "",
            "a PDO without a COB-ID has that of NMT",
            COB_IDS,
        ),
        (
            "described_on_any_can_id",
            "pdo/slots.py",
            "_is_in_use(pdo) and _is_possible",
            "pdo.is_valid and _is_possible",
            "an RPDO of a file is sent as an NMT command",
            COB_IDS,
        ),
        (
            "sent_on_any_can_id",
            "pdo/configure.py",
            "if settings.direction is Direction.RPDO and check_can_id(settings.cob_id) is not None:",
            "if False:",
            "an RPDO of a device is sent as an NMT command",
            COB_IDS,
        ),
        # ---- PDOs that we write while they are exchanged ----
        (
            "decoded_by_the_old_mapping",
            "remote_node.py",
            "            self.remove_pdo(direction, number)\n        self.unread",
            "            pass\n        self.unread",
            "the values of a PDO that was mapped anew are those of other objects",
            REWRITTEN,
        ),
        (
            "sent_by_the_old_mapping",
            "remote_node.py",
            "            self.rpdos[number].set_enabled(False, now)",
            "            pass",
            "a set-point lands in another object, since its RPDO was mapped anew",
            REWRITTEN,
        ),
        (
            "mapped_as_before_the_reset",
            "remote_node.py",
            "            if where in self.read_pdos:\n",
            "            if False:\n",
            "a set-point lands in another object, since a reset has undone the mapping of its RPDO",
            REWRITTEN,
        ),
        (
            "foreign_by_the_old_mapping",
            "foreign_writes.py",
            " if (Direction.RPDO, number) not in unread}",
            "}",
            "another master is said to have written a controlword that it has not written",
            REWRITTEN,
        ),
        (
            "half_of_one_half_of_another",
            "pdo/configure.py",
            "            if self._counted() != self._writes:",
            "            if False:",
            "two procedures set up one PDO, and each is told that the device has its mapping",
            CONFIGURE,
        ),
        (
            "half_old_half_new",
            "pdo/configure.py",
            "            if writes == node.pdo_writes:\n                return settings",
            "            return settings",
            "a mapping that was read while it was written is half the old and half the new one",
            REWRITTEN,
        ),
        # ---- conformance tester ----
        (
            "long_waits_not_excused",
            _EXPECTATIONS,
            "max(waited // LATE_PART, LATE)",
            "LATE",
            "a device fails since the tester's computer was late by a fiftieth of a wait",
            LATE,
        ),
        (
            "late_at_200_ms",
            _EXPECTATIONS,
            "LATE: Final = 20 * MILLISECOND",
            "LATE: Final = 200 * MILLISECOND",
            "a device fails since the tester's computer was late by a period",
            LATE,
        ),
        (
            "failures_noted_again",
            _EXPECTATIONS,
            "        if noted not in self.failures:\n    ",
            "",
            "one fault is counted as many",
            OBJECTS,
        ),
        (
            "live_values_fail",
            _DICTIONARY,
            "elif variable.access is Access.RO and variable.index in MANUFACTURER_AREA:",
            "elif False:",
            "a counter of starts is a failure",
            OBJECTS,
        ),
        (
            "wrong_values_live",
            _DICTIONARY,
            "        if seen == before:\n            _name(bench, variable, seen)\n",
            "",
            "a wrong read-only value is only a remark",
            OBJECTS,
        ),
        (
            "named_in_each_case",
            _DICTIONARY,
            "    bench.wrong_defaults[variable.mux] = seen\n",
            "",
            "each case names the same offender again",
            OBJECTS,
        ),
    )
)
