"""Planted bugs of the program download (CiA 302-3): programs that are called new, or started, without evidence."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

TRANSFER: Final = ("tests/manager/test_program_download.py",)
IDENTITY: Final = ("tests/manager/test_program_identity.py",)

_DOWNLOAD: Final = "manager/programs/download.py"
_OBJECTS: Final = "manager/programs/objects.py"

FLASH_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        (
            "old_program_called_new",
            _DOWNLOAD,
            "        wanted = so_far.id_sent if self.expected is None and is_new else self.expected\n",
            "        wanted = self.expected\n",
            "without an expected identification a boot loader that has gone back to its old program is not noticed",
            IDENTITY,
        ),
        (
            "any_program_is_verified",
            _DOWNLOAD,
            "            so_far.verified_by = before.changed_to(identity, self.stopped)\n",
            '            so_far.verified_by = "it runs"\n',
            "a program is called verified since 0x1F51 says that one runs",
            IDENTITY,
        ),
        (
            "boot_loader_is_new_program",
            _OBJECTS,
            "later.version not in (self.version, stopped.version)",
            "later.version != self.version",
            "the version of the boot loader itself is taken for that of a new program",
            IDENTITY,
        ),
        (
            "started_unverified",
            _DOWNLOAD,
            "if self.expected is None and not self.is_judged and not self.unverified:",
            "if False:",
            "a program that nothing has verified is started, and nobody has allowed it",
            IDENTITY,
        ),
        (
            "confirmed_is_new",
            _DOWNLOAD,
            "            yield from self._compare()  # a reset",
            "            # a reset",
            "a reset before the confirmation brings the old program back, and it is called new",
            IDENTITY,
        ),
        (
            "identity_across_a_boot",
            _OBJECTS,
            "            if self.node.boots == boots:\n",
            "            if True:\n",
            "what a device showed before it went back to its old program counts as evidence",
            IDENTITY,
        ),
        (
            "silence_about_it",
            _DOWNLOAD,
            "remarks = [] if self.so_far.verified_by else [NOT_VERIFIED]",
            "remarks: list[str] = []",
            "nobody is told that nothing was verified",
            IDENTITY,
        ),
        (
            "clear_answered_at_once",
            "simulation/boot_loader.py",
            "self.settings.is_deaf or self.settings.holds_clear else None",
            "self.settings.is_deaf else None",
            "the answer to clear is never held, so a master that does not poll is refused",
            IDENTITY,
        ),
        (
            "lost_blocks_for_ever",
            _DOWNLOAD,
            "        if not lost or self.so_far.writes == WRITES - 1:",
            "        if not lost:",
            "a bus that loses every block transfer never gets the plain one",
            TRANSFER,
        ),
    )
)
