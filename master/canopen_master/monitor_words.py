"""The words of a monitor: the services by which frames are chosen, and how a finding and an event are told. `canopen monitor` has
them, and the page of the web door."""

from __future__ import annotations

import re
from typing import Final

from canopen_master.plain_text import clean
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.story import BusEvent

SERVICES: Final = ("nmt", "sync", "time", "emcy", "sdo", "heartbeat", "boot-up", "guarding", "lss", "nmt master", "?")
"""The services that are no PDOs; those have names of their own, such as TPDO 1. ? is what no service explains."""


def service_word(word: str) -> str:
    """Return the word for a service, as `is_of_service` takes it. Raises ValueError for what is none."""
    word = word.strip().lower()
    if word in SERVICES or re.fullmatch(r"[tr]?pdo( ?[0-9]{1,3})?", word):
        return word
    raise ValueError(f"there is no service {word[:40]!r}; there are {', '.join(SERVICES)}, pdo, tpdo, rpdo")


def is_of_service(service: str, word: str) -> bool:
    """Return whether a service, in lower case, is the one that a word means."""
    if word == "pdo":
        return service not in SERVICES
    if word in SERVICES:
        return service == word
    return re.search(f"{word.replace(' ', '')}(?![0-9])", service.replace(" ", "")) is not None


def finding_text(finding: BusFinding) -> str:
    """Return a finding in words, fit for a screen."""
    likely = "" if finding.is_certain else " (likely)"
    return f"{finding.rule}{likely}: {f'node {finding.node_id}: ' if finding.node_id else ''}{clean(finding.text)}"


def event_text(event: BusEvent) -> str:
    """Return an event in words, fit for a screen."""
    return f"{event.kind}: {f'node {event.node_id}: ' if event.node_id else ''}{clean(event.text)}"
