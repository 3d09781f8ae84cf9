"""`AsciiConnection`: one client of the text door: its defaults, and what its requests mean for the service.

Each client has defaults of its own: its net, and for each net its node, its time-out for SDO, and whether it uses blocks. They
end with its connection. Net n is the n-th bus of the master.

Nothing that a client asks for raises anything here: each request has one answer.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from importlib.metadata import version
from typing import Final, TypeVar

import trio

from canopen_gateway.errors import GatewayError, GatewayFullError, LeaseError, NotAllowedError, PdoTakenError
from canopen_gateway.layer_settings import LayerSettings, window_of
from canopen_gateway.nmt_words import NMT_OF
from canopen_gateway.service import GatewaySession, HeardOnNet
from canopen_master import MasterError, SdoError, SdoGivenUpError, SdoNotConfirmedError
from canopen_proto import LocalProtocolError, ProcedureError
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import bit_length_of
from canopen_proto.frame import COB_ID_INVALID, UNCONFIGURED
from canopen_proto.gateway import (
    CANOPENNODE,
    VALUE_TYPES,
    Dialect,
    GatewayAnswer,
    GatewayCode,
    GatewayCommand,
    GatewayEvent,
    GatewayNews,
    GatewayRequest,
    NodeReport,
    PdoReport,
    code_text,
    parse_request,
    print_event,
    print_value,
)
from canopen_proto.gateway.request import EVENT, RTR, About
from canopen_proto.gateway.value_types import HEX, fits
from canopen_proto.guarding import NodeGuardingLost
from canopen_proto.lss import LssAddress, LssError, LssReply, LssService, LssState
from canopen_proto.lss.messages import BIT_RATES, INQUIRE
from canopen_proto.lss.scan import Known
from canopen_proto.machine import MILLISECOND
from canopen_proto.sdo.client import Block

SDO_TIMEOUT_MS: Final = 500
"""Where a client sets none: what CANopenNode has."""
PROTOCOL: Final = "3.0"
"""The version of CiA 309-3 whose commands these are, as CANopenNode says."""
T = TypeVar("T")

LOGGER: Final = logging.getLogger("canopen_gateway")

C = GatewayCommand
_METHODS: Final = {
    **dict.fromkeys(NMT_OF, "nmt"),
    **dict.fromkeys((C.SET_RPDO, C.SET_TPDO, C.SET_TPDOX), "set_pdo"),
    **dict.fromkeys((C.ENABLE_GUARDING, C.DISABLE_GUARDING), "enable_guarding"),
    **dict.fromkeys((C.ENABLE_HEARTBEAT, C.DISABLE_HEARTBEAT), "enable_heartbeat"),
    **dict.fromkeys((C.ENABLE_BOOT_UP, C.DISABLE_BOOT_UP), "boot_up_indication"),
    **dict.fromkeys((C.HELP, C.HELP_DATATYPE, C.HELP_LSS), "help"),
}
"""The methods of `AsciiConnection` that do more than one command. All others have the name of their command."""
_LSS_ERRORS: Final = {
    LssService.CONFIGURE_NODE_ID: GatewayCode.LSS_NODE_ID,
    LssService.CONFIGURE_BIT_TIMING: GatewayCode.LSS_BIT_RATE,
    LssService.STORE: GatewayCode.LSS_STORE,
}
_OWN_ERROR: Final = 255
"""The error of an LSS slave that is its maker's own."""


@dataclass
class NetDefaults:
    """What a client has set for a net. node_id: None: none yet. sdo_timeout_ms: for each answer of a node. block:
    whether values go in blocks, where the node has them."""

    node_id: int | None = None
    sdo_timeout_ms: int = SDO_TIMEOUT_MS
    block: Block = False


class _Refusal(Exception):
    """This request is answered by an error. remark: for people."""

    def __init__(self, code: GatewayCode, remark: str = "") -> None:
        super().__init__(remark)
        self.code = code
        self.remark = remark


def _out_of_range(number: int, bounds: str) -> _Refusal:
    return _Refusal(GatewayCode.SYNTAX, f"{code_text(GatewayCode.SYNTAX)} {number} is out of range: {bounds}")


class AsciiConnection:
    """See this module's text. wants_events: the client has asked for some."""

    def __init__(self, session: GatewaySession, dialect: Dialect = CANOPENNODE) -> None:
        self.wants_events = False
        self._session = session
        self._service = session.service
        self._dialect = dialect
        self._nets = session.service.nets
        self._net: int | None = 1 if dialect.assumes_net and len(self._nets) == 1 else None
        self._defaults = {number: NetDefaults() for number in range(1, len(self._nets) + 1)}
        self._command_timeout_ms = 0

    async def answer(self, line: bytes) -> GatewayAnswer | None:
        """Do what a line asks for, and return the answer; None for an empty line, or a comment. line: without its end."""
        request = parse_request(line, self._dialect)
        if not isinstance(request, GatewayRequest):
            return request
        seconds = self._command_timeout_ms / 1000 or float("inf")
        with trio.move_on_after(seconds):
            return await self._answer(request)
        return GatewayAnswer(request.sequence, code=GatewayCode.TIME_OUT)

    async def next_event(self) -> HeardOnNet:
        """Wait for the next event that this client has asked for."""
        return await self._session.next_event()

    def event_text(self, heard: HeardOnNet) -> bytes | None:
        """Return an event as the client is told it; None if it has no words for it."""
        event = self._event(self._nets.index(heard.net) + 1, heard.event)
        return None if event is None else print_event(event, self._dialect)

    async def _answer(self, request: GatewayRequest) -> GatewayAnswer:
        sequence = request.sequence
        try:
            command = request.command
            done: GatewayAnswer | str | None = await getattr(self, _METHODS.get(command, command.name.lower()))(request)
        except _Refusal as refusal:
            return GatewayAnswer(sequence, code=refusal.code, remark=refusal.remark)
        except NotAllowedError as error:
            return GatewayAnswer(sequence, code=GatewayCode.NOT_SUPPORTED, remark=f"{error.failed}: {error.seen}")
        except PdoTakenError as error:
            return GatewayAnswer(sequence, code=GatewayCode.PDO_IN_USE, remark=error.failed)
        except GatewayFullError as error:
            return GatewayAnswer(sequence, code=GatewayCode.OUT_OF_MEMORY, remark=error.failed)
        except LeaseError as error:
            return GatewayAnswer(sequence, code=GatewayCode.INTERNAL_STATE, remark=error.failed)
        except SdoNotConfirmedError as error:
            return GatewayAnswer(sequence, abort_code=error.abort_code, remark="not confirmed: it may have been executed")
        except SdoError as error:
            remark = error.cause if isinstance(error, SdoGivenUpError) else ""
            return GatewayAnswer(sequence, abort_code=error.abort_code, remark=remark)
        except LssError as error:
            return GatewayAnswer(sequence, code=GatewayCode.TIME_OUT, remark=str(error))
        except (GatewayError, MasterError, ProcedureError, LocalProtocolError) as error:
            return GatewayAnswer(sequence, code=GatewayCode.INTERNAL_STATE, remark=str(error).partition("\n")[0])
        except Exception:  # a mistake of ours ends neither the door nor the master
            LOGGER.exception("the request %s of %s failed", request.command.name, self._session.name)
            return GatewayAnswer(sequence, code=GatewayCode.INTERNAL_STATE, remark="a mistake in this gateway")
        return done if isinstance(done, GatewayAnswer) else GatewayAnswer(sequence, done)

    # ---- which net and node ----

    def _number_of_net(self, request: GatewayRequest) -> int:
        number = self._net if request.net is None else request.net
        if number is None:
            raise _Refusal(GatewayCode.NO_DEFAULT_NET)
        if not 1 <= number <= len(self._nets):
            raise _Refusal(GatewayCode.UNSUPPORTED_NET)
        return number

    def _net_of(self, request: GatewayRequest) -> str:
        return self._nets[self._number_of_net(request) - 1]

    def _defaults_of(self, request: GatewayRequest) -> NetDefaults:
        return self._defaults[self._number_of_net(request)]

    def _node_of(self, request: GatewayRequest, least: int = 1) -> int:
        node_id = self._defaults_of(request).node_id if request.node is None else request.node
        if node_id is None:
            raise _Refusal(GatewayCode.NO_DEFAULT_NODE)
        if node_id < least:
            raise _Refusal(GatewayCode.UNSUPPORTED_NODE)
        return node_id

    # ---- objects and NMT ----

    async def read(self, request: GatewayRequest) -> GatewayAnswer | str:
        net, node_id, defaults = self._net_of(request), self._node_of(request), self._defaults_of(request)
        if request.value_type is None and not self._dialect.hex_fallback:
            raise _Refusal(GatewayCode.SYNTAX, f"{code_text(GatewayCode.SYNTAX)} A read needs a type")
        value_type = request.value_type or HEX
        index, subindex = request.numbers
        timeout = defaults.sdo_timeout_ms / 1000
        data = await self._session.read(net, node_id, index, subindex, timeout=timeout, block=defaults.block)
        if not fits(value_type, data) and not self._dialect.hex_fallback:
            return GatewayAnswer(request.sequence, abort_code=AbortCode.LENGTH_MISMATCH)
        return print_value(value_type, data, self._dialect)

    async def write(self, request: GatewayRequest) -> None:
        net, node_id, defaults = self._net_of(request), self._node_of(request), self._defaults_of(request)
        index, subindex = request.numbers
        timeout = defaults.sdo_timeout_ms / 1000
        await self._session.write(net, node_id, index, subindex, request.data, timeout=timeout, block=defaults.block)

    async def nmt(self, request: GatewayRequest) -> None:
        node_id = self._node_of(request, 0)
        await self._session.nmt(self._net_of(request), NMT_OF[request.command], node_id)

    async def halt(self, request: GatewayRequest) -> None:
        """Stop what moves. The default node does not count, and without a net all nets are meant: halting too much is better than
        too little."""
        net = None
        if request.net is not None or (request.node and self._net is not None):
            net = self._net_of(request)
        problems = await self._service.halt(net, request.node or 0 if net else 0)
        if problems:
            raise _Refusal(GatewayCode.INTERNAL_STATE, "; ".join(problems))

    # ---- settings of the client ----

    async def set_network(self, request: GatewayRequest) -> None:
        (number,) = request.numbers
        if number > len(self._nets):
            raise _Refusal(GatewayCode.UNSUPPORTED_NET)
        self._net = number or None

    async def set_node(self, request: GatewayRequest) -> None:
        self._defaults_of(request).node_id = request.numbers[0] or None

    async def set_sdo_timeout(self, request: GatewayRequest) -> None:
        self._defaults_of(request).sdo_timeout_ms = request.numbers[0]

    async def set_sdo_block(self, request: GatewayRequest) -> None:
        self._defaults_of(request).block = "auto" if request.numbers[0] else False

    async def set_command_timeout(self, request: GatewayRequest) -> None:
        self._command_timeout_ms = request.numbers[0]

    async def set_command_size(self, request: GatewayRequest) -> None:
        if request.numbers[0] > self._service.limits.line_bytes:
            raise _Refusal(GatewayCode.OUT_OF_MEMORY)

    # ---- the gateway itself ----

    async def set_id(self, request: GatewayRequest) -> None:
        node_id = _new_node_id(request)
        self._service.set_own_id(self._net_of(request), None if node_id == UNCONFIGURED else node_id)

    async def set_heartbeat(self, request: GatewayRequest) -> None:
        self._service.set_own_heartbeat(self._net_of(request), request.numbers[0] * MILLISECOND)

    async def init(self, request: GatewayRequest) -> None:
        """The bus is open already; nothing is switched. Another bit rate than it has is refused, as far as it is known."""
        present = self._service.master.bus(self._net_of(request)).bitrate
        if present is not None and BIT_RATES.get(request.numbers[0], 0) * 1000 != present:
            raise _Refusal(GatewayCode.INTERNAL_STATE, f"the bus is open with {present // 1000} kbit/s")

    async def info_version(self, request: GatewayRequest) -> str:
        """Vendor-ID, product code, revision, serial number, class of the gateway, versions of protocol and implementation. We
        have no vendor-ID, and claim no class."""
        ours = ".".join(version("canopen-proto").split(".")[:2])
        return f"0 0 {ours} 0 0 {PROTOCOL} {ours}"

    async def help(self, request: GatewayRequest) -> str:
        return {C.HELP_DATATYPE: HELP_DATATYPE, C.HELP_LSS: HELP_LSS}.get(request.command, HELP)

    async def led(self, request: GatewayRequest) -> None:
        raise _Refusal(GatewayCode.NOT_SUPPORTED, "this gateway has no LEDs")

    async def log(self, request: GatewayRequest) -> GatewayAnswer:
        texts = [self.event_text(heard) for heard in self._service.log]
        lines = tuple(text.decode("latin-1").strip() for text in texts if text is not None)
        return GatewayAnswer(request.sequence, lines=lines)

    # ---- events ----

    async def boot_up_indication(self, request: GatewayRequest) -> None:
        wanted = request.command is C.ENABLE_BOOT_UP
        self._session.hear_boot_ups(self._net_of(request), wanted)
        self.wants_events |= wanted

    async def enable_heartbeat(self, request: GatewayRequest) -> None:
        milliseconds = 0 if request.command is C.DISABLE_HEARTBEAT else request.numbers[0]
        self._session.watch_heartbeat(self._net_of(request), self._node_of(request), milliseconds * MILLISECOND)
        self.wants_events |= bool(milliseconds)

    async def enable_guarding(self, request: GatewayRequest) -> None:
        guard_time, factor = (0, 0) if request.command is C.DISABLE_GUARDING else request.numbers
        self._session.guard_node(self._net_of(request), self._node_of(request), guard_time / 1000, factor)
        self.wants_events |= bool(guard_time and factor)

    def _event(self, net: int, event: NodeReport | PdoReport | NodeGuardingLost) -> GatewayEvent | None:
        match event:
            case NodeReport(node_id=node_id, kind=kind, numbers=numbers):
                return GatewayEvent(net, node_id, kind, numbers)
            case PdoReport(number=number, values=values):
                return GatewayEvent(net, 0, GatewayNews.PDO, (number, *values))
        return GatewayEvent(net, event.node_id, GatewayNews.ERROR, (int(GatewayCode.GUARDING_LOST),))

    # ---- PDOs of the gateway ----

    async def set_pdo(self, request: GatewayRequest) -> None:
        net, listens = self._net_of(request), request.command is C.SET_RPDO
        number, cob_id, transmission, *further = request.numbers
        widths = [bit_length_of(each.value_type.data_type) or 0 for each in request.mapping]
        if cob_id & COB_ID_INVALID:
            widths = []
        if sum(widths) > 64:
            raise _Refusal(GatewayCode.PDO_LENGTH)
        if transmission == RTR or (not listens and widths and (transmission != EVENT or any(further))):
            remark = (
                "a PDO on request is not supported" if transmission == RTR else "only event-driven PDOs without times are sent"
            )
            raise _Refusal(GatewayCode.NOT_SUPPORTED, remark)
        self._session.set_pdo(net, number, cob_id, widths, listens=listens)
        self.wants_events |= listens and bool(widths)

    async def read_pdo(self, request: GatewayRequest) -> str:
        number = self._number_of_net(request)
        values = self._session.last_pdo(self._net_of(request), request.numbers[0])
        if values is None:
            raise _Refusal(GatewayCode.INTERNAL_STATE, "it has not come yet")
        return " ".join([str(number), "pdo", str(len(values)), *(f"0x{each:x}" for each in values)])

    async def write_pdo(self, request: GatewayRequest) -> None:
        number, *values = request.numbers
        await self._session.send_pdo(self._net_of(request), number, values)

    # ---- layer setting services ----

    def _lss(self, request: GatewayRequest, *, selected: bool = False) -> LayerSettings:
        settings = self._service.layer_settings(self._net_of(request))
        settings.require_allowed(request.command.syntax.words[0][0])
        if selected and not settings.is_selected:
            raise _Refusal(GatewayCode.INTERNAL_STATE, "no device is selected: lss_switch_sel, or lss_switch_glob 1")
        return settings

    async def lss_switch_global(self, request: GatewayRequest) -> None:
        await self._lss(request).switch_global(LssState(request.numbers[0]))

    async def lss_switch_selective(self, request: GatewayRequest) -> None:
        vendor, product, revision, serial = request.numbers
        _answered(await self._lss(request).select(LssAddress(vendor, product, revision, serial)) or None)

    async def lss_set_node(self, request: GatewayRequest) -> None:
        node_id, settings = _new_node_id(request), self._lss(request, selected=True)
        reply = await settings.command("lss_set_node", lambda lss, now: lss.configure_node_id(node_id, now))
        _check_lss(reply)
        if reply.count > 1 and node_id != UNCONFIGURED:
            text = f"{reply.count} devices have taken it, for their next reset: lss_switch_sel selects one"
            raise _Refusal(GatewayCode.INTERNAL_STATE, text)

    async def lss_configure_bit_rate(self, request: GatewayRequest) -> None:
        table, index = request.numbers
        settings = self._lss(request, selected=True)
        _check_lss(await settings.command("lss_conf_bitrate", lambda lss, now: lss.configure_bit_timing(index, now, table=table)))

    async def lss_activate_bit_rate(self, request: GatewayRequest) -> None:
        settings, net = self._lss(request), self._net_of(request)
        await self._service.lease.require_no_power(self._session, net, 0, "another bit rate")  # its drives would hear nobody
        await settings.activate_bit_timing(request.numbers[0] * MILLISECOND)

    async def lss_store(self, request: GatewayRequest) -> None:
        _check_lss(await self._lss(request, selected=True).command("lss_store", lambda lss, now: lss.store(now)))

    async def lss_inquire_address(self, request: GatewayRequest) -> str:
        settings = self._lss(request, selected=True)
        if request.numbers and request.numbers[0] not in (0, 1, 2, 3, *map(int, INQUIRE)):
            raise _out_of_range(request.numbers[0], f"0 to 3, 0x{min(INQUIRE):X} to 0x{max(INQUIRE):X}")
        wanted = [INQUIRE[each] if each < len(INQUIRE) else LssService(each) for each in request.numbers] or INQUIRE
        return self._numbers([_answered(await settings.inquire(service)) for service in wanted])

    async def lss_get_node(self, request: GatewayRequest) -> str:
        node_id = _answered(await self._lss(request, selected=True).inquire(LssService.INQUIRE_NODE_ID))
        return str(node_id) if self._dialect.unsigned_hex else f"0x{node_id:02X}"

    async def lss_identity(self, request: GatewayRequest) -> None:
        vendor, product, low, high, first, last = request.numbers
        reply = await self._lss(request).command(
            "lss_identity", lambda lss, now: lss.identify(vendor, product, (low, high), (first, last), now)
        )
        _answered(reply.count or None)

    async def lss_identify_non_configured(self, request: GatewayRequest) -> None:
        reply = await self._lss(request).command("lss_ident_nonconf", lambda lss, now: lss.identify_non_configured(now))
        _answered(reply.count or None)

    async def lss_slowscan(self, request: GatewayRequest) -> str:
        vendor, product, low, high, first, last = request.numbers
        found = await self._lss(request).slowscan(vendor, product, (low, high), (first, last))
        return self._numbers(_answered(found or None)[0])

    async def lss_fastscan(self, request: GatewayRequest) -> str:
        numbers = request.numbers
        milliseconds = 0
        known: Known = (None, None, None, None)
        if len(numbers) == 1:
            milliseconds = numbers[0]
            if milliseconds > 0xFFFF:
                raise _out_of_range(milliseconds, f"0 to {0xFFFF}")
        elif numbers:
            known = _known(numbers[::2], numbers[1::2])
        address = await self._lss(request).fastscan(known, window_of(milliseconds))
        return self._numbers(_answered(address))

    async def lss_all_nodes(self, request: GatewayRequest) -> GatewayAnswer:
        numbers = request.numbers
        first, store = numbers[1:3] if len(numbers) >= 3 else (2, 1)
        kinds, given = numbers[3::2], numbers[4::2]
        known = tuple(number if kind == 2 else None for kind, number in zip(kinds, given, strict=True)) or (None,) * 4
        window = window_of(numbers[0] if numbers else 0)
        vendor, product, revision, serial = known
        done = await self._lss(request).assign_all(first, bool(store), (vendor, product, revision, serial), window)
        lines = [f"Node-ID {each.node_id} assigned to: {self._numbers(each.address)}" for each in done.done if each.written]
        lines += [f"{self._numbers(each.address)}: {each.remark}" for each in done.done if each.remark]
        lines += [f"{self._numbers(address)}: {why}" for address, why in done.left.items()]
        # CANopenNode's words, which its client reads: "1 nodes" too
        lines.append(done.unfinished or f"Found {sum(each.written for each in done.done)} nodes, search finished.")
        failed = any(not each.is_complete for each in done.done) or done.unfinished
        code = GatewayCode.INTERNAL_STATE if failed else 0
        return GatewayAnswer(request.sequence, code=int(code), lines=tuple(lines))

    def _numbers(self, numbers: list[int] | LssAddress) -> str:
        return " ".join(f"0x{each:08x}" if self._dialect.unsigned_hex else f"0x{each:08X}" for each in numbers)


def _new_node_id(request: GatewayRequest) -> int:
    (node_id,) = request.numbers
    if node_id == 0 or 127 < node_id < UNCONFIGURED:
        raise _out_of_range(node_id, f"1 to 127, or {UNCONFIGURED}")
    return node_id


def _answered(found: T | None) -> T:
    """Return what was found; nothing is answered as a time-out."""
    if found is None:
        raise _Refusal(GatewayCode.TIME_OUT)
    return found


def _known(numbers: tuple[int, ...], masks: tuple[int, ...]) -> Known:
    """Return the numbers of an address that are known, of Lely's pairs of number and mask. A part of a number cannot be known."""
    if any(mask not in (0, 0xFFFF_FFFF) for mask in masks):
        raise _Refusal(GatewayCode.NOT_SUPPORTED, "a mask is 0, or 0xFFFFFFFF")
    vendor, product, revision, serial = (number if mask else None for number, mask in zip(numbers, masks, strict=True))
    return vendor, product, revision, serial


def _check_lss(reply: LssReply) -> None:
    """Refuse what the selected device did not do."""
    for answer in _answered(reply.answers or None):
        if answer[1]:
            raise _Refusal(GatewayCode.LSS_MAKER if answer[1] == _OWN_ERROR else _LSS_ERRORS[reply.service])


_ARGUMENTS: Final = {
    C.READ: "index subindex [type]",
    C.WRITE: "index subindex type value",
    C.SET_NETWORK: "net",
    C.SET_NODE: "node",
    C.SET_SDO_TIMEOUT: "ms",
    C.SET_SDO_BLOCK: "0|1",
    C.SET_ID: "node",
    C.SET_HEARTBEAT: "ms",
    C.SET_COMMAND_TIMEOUT: "ms",
    C.SET_COMMAND_SIZE: "bytes",
    C.SET_RPDO: "number cob-id event|sync<n> count {[index subindex] type}",
    C.SET_TPDO: "number cob-id event count {[index subindex] type}",
    C.SET_TPDOX: "number cob-id event inhibit timer count {[index subindex] type}",
    C.READ_PDO: "number",
    C.WRITE_PDO: "number count {value}",
    C.ENABLE_GUARDING: "ms factor",
    C.ENABLE_HEARTBEAT: "ms",
    C.INIT: "bit-rate-index",
    C.LSS_SWITCH_GLOBAL: "0|1",
    C.LSS_SWITCH_SELECTIVE: "vendor product revision serial",
    C.LSS_SET_NODE: "node",
    C.LSS_CONFIGURE_BIT_RATE: "table index",
    C.LSS_ACTIVATE_BIT_RATE: "ms",
    C.LSS_INQUIRE_ADDRESS: "[0..3]",
    C.LSS_IDENTITY: "vendor product revision-low revision-high serial-low serial-high",
    C.LSS_SLOWSCAN: "vendor product revision-low revision-high serial-low serial-high",
    C.LSS_FASTSCAN: "[ms] | {number mask} of vendor, product, revision, serial",
    C.LSS_ALL_NODES: "[ms [first-node store [{0|1|2 number} of vendor, product, revision, serial]]]",
}
_BEFORE: Final = {About.GATEWAY: "", About.NET: "[net] ", About.NODE: "[[net] node] "}


def _help_line(command: GatewayCommand) -> str:
    words = " ".join("|".join(spellings) for spellings in command.syntax.words)
    return f"[seq] {_BEFORE[command.about]}{words} {_ARGUMENTS.get(command, '')}".rstrip()


_IS_LSS: Final = {command: "lss" in command.syntax.words[0][0] for command in C}
HELP: Final = "\n".join(["commands:", *(_help_line(each) for each in C if not _IS_LSS[each]), "more: help lss, help datatype"])
HELP_LSS: Final = "\n".join(["layer setting services:", *(_help_line(each) for each in C if _IS_LSS[each])])
HELP_DATATYPE: Final = "\n".join(
    ["types:", *(f"{each.word}: {each.data_type.name}, {each.form.value}" for each in VALUE_TYPES.values())]
)
