"""Chapter 2, at its end: further SDO channels (CiA 301 v4.2.0, 7.5.2.33 and 7.5.2.34).

A server (0x1201 to 0x127F) whose COB-IDs can be written is tried with two CAN-IDs that the predefined connection set leaves free.
Of a client (0x1280 to 0x12FF) only the record can be tested: the device alone decides when it sends requests.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canopen_check.bench import ANSWER_TIME, REACTION_TIME, Bench
from canopen_check.case import Case, for_each
from canopen_check.dictionary_cases import expect_defaults
from canopen_check.expectations import expect_refusal, some
from canopen_check.raw_sdo import ask, initiate
from canopen_check.sdo_cases import NO_OBJECT
from canopen_check.storing_cases import save
from canopen_proto.cob_id import is_valid
from canopen_proto.dictionary import Variable
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_INVALID, RoutingKey, key_of_cob_id
from canopen_proto.indices import DEVICE_TYPE, SDO_CLIENTS
from canopen_proto.nmt import NmtCommand
from canopen_proto.parameter_storage import STORE
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.channels import FURTHER_SERVERS, TO_CLIENT, TO_SERVER
from canopen_proto.sdo.codec import INITIATE_UPLOAD
from canopen_proto.verdict import expect, expect_equal

TRIAL_TO_SERVER: Final = RoutingKey(0x6D0)
TRIAL_TO_CLIENT: Final = RoutingKey(0x6D1)

_REQUEST: Final = initiate(INITIATE_UPLOAD, DEVICE_TYPE, 0)


def read_records(bench: Bench, indices: range) -> Procedure[str]:
    """Check that present records hold their defaults, and that missing ones cannot be read. indices: of the records."""

    def look(index: int) -> Procedure[None]:
        code = yield from bench.refusal_of_read(index, 0)
        expect_refusal(code, NO_OBJECT, f"reading 0x{index:04X}:00, which is not in the dictionary,")

    yield from for_each(bench, [index for index in indices if not bench.dictionary.has_index(index)], look)
    return (yield from expect_defaults(bench, _fields(bench, indices)))


def _fields(bench: Bench, indices: range) -> Iterator[Variable]:
    for variable in bench.dictionary:
        if variable.index in indices and variable.access.readable and variable.default is not None:
            yield variable


def configurable(bench: Bench, indices: range) -> list[int]:
    """Return the records whose COB-IDs can be written. indices: of the records."""
    found = []
    for index in indices:
        cob_ids = [bench.dictionary.get(index, subindex) for subindex in (TO_SERVER, TO_CLIENT)]
        if all(each is not None and each.access.writable for each in cob_ids):
            found.append(index)
    return found


def write_channel(bench: Bench, index: int, to_server: int, to_client: int) -> Procedure[None]:
    """Give a record other COB-IDs, in the order that the standard wants: not valid first. to_server, to_client: the COB-IDs."""
    for subindex, cob_id in ((TO_SERVER, to_server), (TO_CLIENT, to_client)):
        present = yield from bench.number(index, subindex)
        yield from bench.write(index, subindex, present | COB_ID_INVALID)
        yield from bench.write(index, subindex, cob_id)


def expect_server(bench: Bench, index: int, to_server: RoutingKey, to_client: RoutingKey) -> Procedure[None]:
    """Check that a request is answered on its channel, as the first server answers it, and on no other. to_server, to_client: its
    routing keys."""
    expected = yield from ask(bench, _REQUEST)
    bench.probe.listen_also(to_client)
    yield from bench.send(to_server, _REQUEST)
    what = f"the answer of the server of 0x{index:04X}"
    heard = yield from bench.next_frame(to_client, ANSWER_TIME, what)
    expect_equal(heard.frame.data, expected, what)
    yield from bench.expect_silence(bench.response_key, REACTION_TIME, f"beside {what}")


def expect_no_server(bench: Bench, when: str) -> Procedure[None]:
    """Check that a request to the trial channel gets no answer. when: for the text."""
    bench.probe.listen_also(bench.response_key)
    yield from bench.send(TRIAL_TO_SERVER, _REQUEST)
    yield from bench.expect_silence(TRIAL_TO_CLIENT, REACTION_TIME, when)
    expect(not bench.probe.take_all(bench.response_key), f"{when}: the first server answered")


def further_servers(bench: Bench) -> Procedure[str]:
    """2.28: the records are there and take effect: there is a channel while both COB-IDs are valid, else none."""
    remark = yield from read_records(bench, FURTHER_SERVERS)
    for index in FURTHER_SERVERS:
        cob_ids = bench.default(index, TO_SERVER), bench.default(index, TO_CLIENT)
        if all(map(is_valid, cob_ids)):
            yield from expect_server(bench, index, *map(key_of_cob_id, cob_ids))
    for index in configurable(bench, FURTHER_SERVERS):
        yield from write_channel(bench, index, TRIAL_TO_SERVER, TRIAL_TO_CLIENT | COB_ID_INVALID)
        yield from expect_no_server(bench, f"0x{index:04X} with one valid COB-ID")
        yield from bench.write(index, TO_CLIENT, TRIAL_TO_CLIENT)
        yield from expect_server(bench, index, TRIAL_TO_SERVER, TRIAL_TO_CLIENT)
        yield from bench.write(index, TO_SERVER, TRIAL_TO_SERVER | COB_ID_INVALID)
        yield from expect_no_server(bench, f"0x{index:04X}, no longer valid")
    return remark


def servers_after_reset(bench: Bench) -> Procedure[str]:
    """2.29: reset communication puts the records back, and closes the channels that they no longer hold."""
    found = some(configurable(bench, FURTHER_SERVERS), "no further SDO server has COB-IDs that can be written")
    for index in found:
        yield from write_channel(bench, index, TRIAL_TO_SERVER, TRIAL_TO_CLIENT)
        yield from expect_server(bench, index, TRIAL_TO_SERVER, TRIAL_TO_CLIENT)
        yield from bench.reset(NmtCommand.RESET_COMMUNICATION)
        yield from expect_no_server(bench, f"0x{index:04X}, after reset communication")
    return (yield from read_records(bench, FURTHER_SERVERS))


def saved_clients(bench: Bench) -> Procedure[str]:
    """2.30: saved values of the records are there after reset communication. The case ends with the values saved before."""
    yield from read_records(bench, SDO_CLIENTS)
    found = some(configurable(bench, SDO_CLIENTS), "no SDO client has COB-IDs that can be written")
    before = []
    for index in found:
        to_server = yield from bench.number(index, TO_SERVER)
        before.append((index, to_server, (yield from bench.number(index, TO_CLIENT))))
    trial = [(index, TRIAL_TO_SERVER, TRIAL_TO_CLIENT) for index in found]
    for saved in (trial, before):
        for channel in saved:
            yield from write_channel(bench, *channel)
        yield from save(bench)
        yield from bench.reset(NmtCommand.RESET_COMMUNICATION)
        for index, to_server, to_client in saved:
            for subindex, cob_id in ((TO_SERVER, to_server), (TO_CLIENT, to_client)):
                yield from bench.expect_number(index, subindex, cob_id, "saved, after reset communication")
    return counted(len(found), "client")


CASES: Final = (
    Case("2.28", "SDO 28", "Read 0x1201 and following objects", further_servers, (DEVICE_TYPE,)),
    Case("2.29", "SDO 29", "Read 0x1201 and following objects after reset communication", servers_after_reset, (DEVICE_TYPE,)),
    Case(
        "2.30",
        "SDO 30",
        "Read 0x1280 and following objects after save and reset communication",
        saved_clients,
        (STORE,),
        stores=True,
    ),
)
