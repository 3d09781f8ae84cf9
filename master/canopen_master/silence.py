"""The likely cause if a node does not answer, from the frames heard on the bus, and what to try next.

A `Diagnosis` is made when a request of ours, or a wait, has ended without an answer. It gives what the core remembers of the node
and of the bus, then the best guess, then the next step. The core goes by the predefined connection set
(canopen_proto/bus_knowledge.py), so its memory is only a hint if COB-IDs were changed. While the bus itself is away
(`Network.outage`), the diagnosis says only that. If the transport filters (`Network.hears_all` is False), it says nothing of
other nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from canopen_proto.bus_knowledge import HeardService, NodeHeard
from canopen_proto.error_codes import error_text
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from canopen_proto.network import Network
from canopen_proto.nmt import COMMAND_OF_BYTE, SERVICES, NmtState, Service, target_of
from canopen_proto.remote_node import RemoteNode

RECENT: Final = 5 * SECOND
"""An older frame says little about now: most heartbeats come about once a second."""
ALIVE: Final = 2 * SECOND
"""A node counts as alive if it was heard within this time. After an older frame its power may be off by now."""
BOOTING: Final = 2 * SECOND
"""For so long after its boot-up a device may still be busy starting."""
MAX_NODES_TOLD: Final = 8
TIMEOUTS: Final = (0.1, 0.2, 0.5, 1, 2, 3, 5, 10, 20)
"""Seconds to advise if an answer came too late: the first that leaves half as much again in reserve."""

SCAN: Final = "canopen scan    (who is there?)"
DOCTOR: Final = "canopen doctor    (what does the adapter say?)"
NOT_BOOTED: Final = "it needs longer to start, or did not get the reset"
LONGER: Final = "a longer sdo_timeout"
LOST_HERE: Final = "it may be among the frames that were lost here: this program, or its computer, was busy"


class Diagnosis(NamedTuple):
    """seen: what was observed. cause: the likely causes, best first. tries: what to do next, best first."""

    seen: str
    cause: str
    tries: tuple[str, ...]


def two_devices(network: Network, node_id: int, now: Time) -> str:
    """Return, for people, that two devices have lately answered one request with two values; "" if they have not."""
    second = network.heard(node_id).second_answer
    if second is None or now - second.time > RECENT:
        return ""
    return f"two devices answer as node {node_id}"


def sdo_silence(network: Network, node: RemoteNode, now: Time) -> Diagnosis:
    """Return why a node did not answer an SDO request in time."""
    if network.outage:
        return _away(network)
    heard = network.heard(node.node_id)
    time, seen = _sign_of_life(heard, node, now)
    commanded, theirs = _foreign_command(heard, node, now)
    if time is None:
        silent = _silent(network, heard, now)
        if network.last_heard is None:
            return silent
        stopped = f"canopen nmt preop {node.node_id}    (a node that is Stopped answers again)"
        cause = f"{silent.cause}; or it is Stopped and has no heartbeat"
        return Diagnosis(silent.seen + theirs + lost_frames(network, now, RECENT), cause, (*silent.tries, stopped))
    node_id, state = node.node_id, _state(heard, node) if commanded is None else commanded
    others, their_cause = _other_clients(network, heard, node, now)
    gap = lost_frames(network, now, RECENT)
    seen += theirs + others + gap
    if state is NmtState.INITIALISING:
        return Diagnosis(seen, "it was reset, and has not booted since", ("the same once it has booted", SCAN))
    if state is not None and Service.SDO not in SERVICES[state]:
        return Diagnosis(seen, f"{_capital(state)}: no SDO in that state", (f"canopen nmt preop {node_id}",))
    late = heard.late_answer
    if late is not None and now - late.time <= RECENT:
        took = (late.behind + node.sdo.timeout) / SECOND
        advised = next((limit for limit in TIMEOUTS if limit >= 1.5 * took), None)
        longer = LONGER if advised is None else f"{LONGER}: {advised:g} s"
        seen += f"; it answered after {_duration(late.behind + node.sdo.timeout)}, too late"
        return Diagnosis(seen, "it is slower than the time limit", (longer,))
    if gap:
        return Diagnosis(seen, LOST_HERE, ("the same once more", DOCTOR))
    if now - time > ALIVE or node.heartbeat.lost:
        cause = "its power is off or its cable loose by now, or it is busy"
        return Diagnosis(seen, cause, (f"check power and cable of node {node_id}", SCAN))
    if heard.service is HeardService.BOOT_UP and now - time <= BOOTING:
        return Diagnosis(seen, "it has just started, and is not ready yet", ("the same once more", LONGER))
    if their_cause:
        is_client = heard.foreign_request is not None and now - heard.foreign_request.time <= RECENT
        tries = ("end the other one, or wait until it is done",) if is_client else ("take one of the two off the bus", SCAN)
        return Diagnosis(seen, their_cause, tries)
    return Diagnosis(seen, "it is busy, or the answer was lost", (LONGER,))


def missing_frame(
    network: Network, node: RemoteNode, now: Time, cause: str, tries: Sequence[str], *, pdo: bool, is_asked: bool = False
) -> Diagnosis:
    """Return why a node did not send an expected frame: a PDO, or a boot-up or heartbeat.

    cause, tries: for a node that is alive. For a boot-up or heartbeat they also hold for a silent node: a device without a
    heartbeat is silent until it is asked. is_asked: it was, by a reset, so that a silent node is most likely not there.
    """
    if network.outage:
        return _away(network)
    heard = network.heard(node.node_id)
    time, seen = _sign_of_life(heard, node, now)
    if time is None:
        silent = _silent(network, heard, now)
        if is_asked:
            return Diagnosis(silent.seen, f"{silent.cause}; or {cause}", (*silent.tries, *tries))
        return silent if pdo else Diagnosis(silent.seen, f"{cause}; or {silent.cause}", (*tries, *silent.tries))
    commanded, theirs = _foreign_command(heard, node, now)
    gap = lost_frames(network, now, RECENT)
    seen += theirs + gap
    state = _state(heard, node) if commanded is None else commanded
    if pdo and state is not None and Service.PDO not in SERVICES[state]:
        return Diagnosis(seen, f"{_capital(state)}: no PDO in that state", (f"canopen nmt start {node.node_id}",))
    return Diagnosis(seen, f"{LOST_HERE}; or {cause}" if gap else cause, tuple(tries))


def _away(network: Network) -> Diagnosis:
    return Diagnosis(network.outage, "neither the request nor an answer can pass", ("the same once the bus is back", DOCTOR))


def _state(heard: NodeHeard, node: RemoteNode) -> NmtState | None:
    """Return the state that the node reported, or that we commanded since."""
    return node.nmt_state if node.nmt_state is not None else heard.state


def lost_frames(network: Network, now: Time, within: Time) -> str:
    """Return, for people, that received frames were lost here within so many ns; "" if none were."""
    gap = network.gap
    if gap is None or now - gap.time > within:
        return ""
    return f"; received frames were lost here {_ago(now - gap.time)}, {gap.lost} at least: {gap.reason}"


def _foreign_command(heard: NodeHeard, node: RemoteNode, now: Time) -> tuple[NmtState | None, str]:
    """Return the state that another NMT master has commanded, and a line about it, if no heartbeat of the node came since, and no
    command of ours."""
    command = heard.foreign_command
    kind = None if command is None else COMMAND_OF_BYTE.get(command.frame.data[0])
    since = max(node.commanded_at, -NEVER if heard.state_time is None else heard.state_time)
    if command is None or kind is None or command.time <= since:
        return None, ""
    words = kind.name.lower().replace("_", " ")
    return target_of(kind), f"; another master commanded it: NMT {words}, {_ago(now - command.time)}"


def _sign_of_life(heard: NodeHeard, node: RemoteNode, now: Time) -> tuple[Time | None, str]:
    """Return when the node was last heard, and a line about it; None if it was never heard."""
    # Its PDOs count too, if they are known to be its own: those that the RemoteNode decodes.
    value_time = max(node.heard_at.values(), default=None)
    if heard.time is None and value_time is None:
        return None, ""
    if heard.time is None or heard.service is None or (value_time is not None and value_time > heard.time):
        assert value_time is not None
        time, what = value_time, "PDO"
    else:
        time, what = heard.time, heard.service.value
    age = now - time
    is_lost = node.heartbeat.lost and what == HeardService.HEARTBEAT.value
    text = f"{'its heartbeat is lost, ' if is_lost else ''}node {heard.node_id} was last heard {_ago(age)} ({what})"
    state = _state(heard, node)
    if state is not None:
        text += f", NMT state {state.name}"
        if heard.state is not state:
            text += " by our command"
        elif heard.state_time is not None and heard.state_time < time:
            text += f" {_ago(now - heard.state_time)}"
    if heard.emcy is not None and heard.emcy.error_code:
        code = heard.emcy.error_code
        text += f"; emergency 0x{code:04X} ({error_text(code)}) {_ago(now - heard.emcy.time)}"
    return time, text


def _other_clients(network: Network, heard: NodeHeard, node: RemoteNode, now: Time) -> tuple[str, str]:
    """Return the signs that another client asks this node, and their meaning; "" if there are none."""
    node_id, request, answer = heard.node_id, heard.foreign_request, heard.unasked_answer
    if node.sdo.can_id != SDO_CLIENT_TO_SERVER + node_id:
        return "", ""  # we use a further channel (`move_sdo`); what is heard of others is on the first one
    if request is not None and now - request.time <= RECENT:
        can_id = SDO_CLIENT_TO_SERVER + node_id
        seen = f"; another client asked it {_ago(now - request.time)} (0x{can_id:X}{_said(request.frame, node)})"
        return seen, "another SDO client talks to it, and an SDO channel serves one at a time"
    if answer is not None and now - answer.time <= RECENT:
        can_id = SDO_SERVER_TO_CLIENT + node_id
        said = _said(answer.frame, node)
        seen = f"; answers seen on 0x{can_id:X} that were not for us, the last {_ago(now - answer.time)}{said}"
        if network.hears_all:  # a request of somebody else's would have been heard
            return seen, f"two devices have node-ID {node_id}, or it answers something else than it is asked, or twice"
        return seen, f"two devices have node-ID {node_id}, or another SDO client talks to it (its requests are filtered)"
    return "", ""


def _said(frame: Frame, node: RemoteNode) -> str:
    """Return what an SDO frame says of an object, as ": read 6041:00 statusword"; "" if it does not name the object."""
    from canopen_proto.observer.observer import Observer  # only here: a session without a silence is without its tables

    meaning = Observer({node.node_id: node.dictionary}.get).observe(frame, 0).meaning
    return f": {meaning.text}" if meaning.objects else ""


def _silent(network: Network, heard: NodeHeard, now: Time) -> Diagnosis:
    node_id = heard.node_id
    check = f"check the node-ID {node_id} (0x{node_id:02X}), power and bit rate"
    last = network.last_heard
    if last is None and network.hears_all:
        cause = "no other node is on it; or wrong bit rate, no power, or the wiring: CAN-H and CAN-L, termination"
        return Diagnosis("nothing at all was heard on this bus", cause, ("check bit rate, power and wiring", SCAN))
    seen, cause = "nothing was heard of it", "no device has this node-ID, its power is off, or it runs with another bit rate"
    if heard.pdo is not None:
        seen += f" but a PDO on 0x{heard.pdo.frame.can_id:X} {_ago(now - heard.pdo.time)}, which may be another node's"
        cause = f"its SDO server does not serve, or it is another node's PDO and no device has node-ID {node_id}"
    others = network.heard_nodes()
    if not network.hears_all:
        seen += " (frames are filtered: other nodes may be there)"
    elif others:
        seen += f": only {_nodes(others)} heard"
        if heard.pdo is None:  # the bit rate is right, since others are heard
            cause = "no device has this node-ID, or its power is off"
        hexadecimal = int(str(node_id), 16)
        if hexadecimal in others:
            cause = f"perhaps node {hexadecimal} was meant, which is 0x{hexadecimal:X}"
        check = f"check the node-ID {node_id} (0x{node_id:02X}) and its power"
    elif last is not None and heard.pdo is None:
        seen += f": frames were ({_ago(now - last)}), but none shows whose it is"
    if heard.foreign_request is not None:
        seen += "; another client asked it too, and got no answer"
    return Diagnosis(seen, cause, (check, SCAN))


def _nodes(node_ids: Sequence[int]) -> str:
    """ "node 6 was", "nodes 6 and 7 were", "nodes 1, 2, 3 and 9 more were"."""
    if len(node_ids) == 1:
        return f"node {node_ids[0]} was"
    if len(node_ids) > MAX_NODES_TOLD:
        return f"nodes {', '.join(map(str, node_ids[:MAX_NODES_TOLD]))} and {len(node_ids) - MAX_NODES_TOLD} more were"
    return f"nodes {', '.join(map(str, node_ids[:-1]))} and {node_ids[-1]} were"


def _duration(time: Time) -> str:
    if time < SECOND:
        return f"{time / MILLISECOND:.0f} ms"
    return f"{time / SECOND:.3g} s" if time < 120 * SECOND else f"{time / SECOND / 60:.0f} min"


def _ago(age: Time) -> str:
    return f"{_duration(age)} ago"


def _capital(state: NmtState) -> str:
    return state.name.capitalize().replace("_", "-")
