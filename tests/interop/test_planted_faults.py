"""Nothing is found in recorded sessions but what is known of them; each fault that is planted in one is found."""

from __future__ import annotations

from functools import cache
from random import Random

import pytest

from canopen_proto.frame import SYNC, Frame
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.observer.observer import RULES
from tests.examples import takes_all
from tests.interop.cct_session import SESSION
from tests.interop.faults import CHANGES, KNOWN, SCENES, Found, Session, found_in
from tests.interop.recorded import FOLDER, Line, load, needs_recordings

pytestmark = needs_recordings

SESSIONS = sorted(path.stem for path in FOLDER.glob("*.log")) or ["none"]
PLACES = 4 if takes_all() else 1
SHARE = 1 if takes_all() else 6
"""Every day each session has one in so many scenes."""


@cache
def session_of(name: str) -> Session:
    return load(name)


@cache
def known_in(name: str) -> list[Found]:
    return found_in(session_of(name))


@pytest.mark.parametrize("name", SESSIONS)
def test_nothing_else_is_found(name: str) -> None:
    assert [found.rule for found in known_in(name)] == KNOWN.get(name, [])


def test_every_rule_is_planted() -> None:
    assert {scene.rule for scene in SCENES} == set(RULES)


@pytest.mark.parametrize("name", SESSIONS)
def test_a_changed_frame_is_found(name: str) -> None:
    random, session = Random(name), session_of(name)
    for change in CHANGES:
        places = change.places(session)
        for at in random.sample(places, min(PLACES, len(places))):
            found = [each.rule for each in change.found(session, at, known_in(name))]
            assert found[:1] == [change.rule], f"{change.rule} at frame {at}: {session[at].text}"


@pytest.mark.parametrize("name", SESSIONS)
def test_faults_of_two_further_devices_are_found_and_nothing_else(name: str) -> None:
    random, session = Random(name), session_of(name)
    has_sync = any(line.frame.can_id == SYNC for line in session)
    for scene in SCENES[SESSIONS.index(name) % SHARE :: SHARE]:
        if has_sync and scene.has_sync:
            continue  # two producers
        for _ in range(PLACES):
            begin = scene.begin_in(session, random)
            found = scene.found(session, begin, known_in(name))
            if scene.is_faulty and not scene.is_explained(session, begin):
                assert scene.rule in {each.rule for each in found}, f"{scene.rule} from {begin} on"
                assert all(each.line.time >= begin for each in found)
            else:
                assert found == [], f"{scene.rule} from {begin} on"


def test_the_conformance_tools_own_faults_are_found() -> None:
    """The tool breaks the protocol on purpose, to see what the device does. The session has no times."""
    if not (FOLDER / SESSION).exists():
        pytest.skip(f"no {SESSION} in {FOLDER}")
    lines: Session = []
    title, titles = "", {}
    for text in (FOLDER / SESSION).read_text().splitlines():
        if text[0] == "#":
            title = text[2:]
        elif text[0] in "<>":
            after = SECOND if text[2:6] == "704#" else 2 * MILLISECOND
            lines.append(Line(lines[-1].time + after if lines else 0, Frame.parse(text[2:])))
            titles[lines[-1].time] = title
    rules = [
        (titles[each.line.time], each.rule)
        for each in found_in(lines)
        if each.rule not in ("late heartbeat", "missing", "copied")
    ]
    assert rules == [
        ("2.7 SDO 07", "sdo"),  # a command that does not exist
        ("2.17 SDO 17", "toggle"),
        ("2.27 SDO 27", "sdo"),  # more segments are acknowledged than a block has
    ]
