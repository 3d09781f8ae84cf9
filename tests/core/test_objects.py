"""Procedures that read and write one node's objects by name and value."""

from __future__ import annotations

from typing import Any

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import NotInDictionaryError, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.machine import LocalProtocolError, Outcome
from canopen_proto.procedures.objects import UnexpectedLengthError, read, read_if_present, read_int, write
from canopen_proto.procedures.runner import ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure, SdoTransferError
from canopen_proto.remote_node import RemoteNode
from tests.core.devices import LIMITED, OUTPUT, Pair, io_device


def outcome_of(pair: Pair, procedure: Procedure[Any]) -> Outcome:
    pair.bus.events.clear()
    pair.master.run(procedure, pair.bus.now)
    pair.bus.settle()
    (outcome,) = [event for event in pair.bus.events if isinstance(event, ProcedureFinished | ProcedureFailed)]
    return outcome


def result_of(pair: Pair, procedure: Procedure[Any]) -> Any:
    outcome = outcome_of(pair, procedure)
    assert isinstance(outcome, ProcedureFinished), outcome
    return outcome.result


def error_of(pair: Pair, procedure: Procedure[Any]) -> Exception:
    outcome = outcome_of(pair, procedure)
    assert isinstance(outcome, ProcedureFailed), outcome
    return outcome.error


def test_read_and_write() -> None:
    pair = Pair()
    assert result_of(pair, write(pair.remote, "output", -5)) is None
    assert pair.local.values.store[OUTPUT << 8] == pair.remote.values.store[OUTPUT << 8] == -5
    assert result_of(pair, read(pair.remote, "output")) == -5
    assert result_of(pair, read_int(pair.remote, (OUTPUT, 0))) == -5
    assert result_of(pair, read(pair.remote, "text")) == "an I/O device with a long name"
    assert pair.remote.values.store[0x200300] == "an I/O device with a long name"


def test_what_the_dictionary_forbids_ends_the_procedure_and_nothing_is_sent() -> None:
    pair = Pair()
    assert isinstance(error_of(pair, write(pair.remote, "input", 1)), LocalProtocolError)
    assert isinstance(error_of(pair, read(pair.remote, "inputt")), NotInDictionaryError)
    assert pair.bus.trace() == []


def test_what_the_device_refuses() -> None:
    pair = Pair()
    more = io_device().with_objects([standard_object(0x1010, highest=1), standard_object(0x1008)])
    remote = RemoteNode(pair.master.out, 5, more)
    pair.master.detach(pair.remote)
    pair.master.attach(remote)
    error = error_of(pair, read(remote, 0x1008))
    assert isinstance(error, SdoTransferError)
    assert (error.abort_code, error.origin) == (AbortCode.NO_SUCH_OBJECT, AbortOrigin.PEER)
    assert str(error) == ("node 5 refused reading 0x1008:00: abort 0x06020000, object does not exist in the object dictionary")
    error = error_of(pair, write(remote, (0x1010, 1), 0x65766173))
    assert isinstance(error, SdoTransferError)
    assert "refused writing 0x1010:01" in str(error)
    assert result_of(pair, read_if_present(remote, 0x1008)) is None


def test_read_if_present() -> None:
    pair = Pair()
    assert result_of(pair, read_if_present(pair.remote, "limited")) == 10
    assert result_of(pair, read_if_present(pair.remote, "no such thing")) is None
    assert pair.bus.trace() != []


def test_read_if_present_hides_no_other_failure() -> None:
    pair = Pair()
    pair.bus.detach(pair.device)
    error = error_of(pair, read_if_present(pair.remote, "limited"))
    assert isinstance(error, SdoTransferError)
    assert error.origin is AbortOrigin.TIMEOUT
    assert str(error) == "node 5 did not answer reading 0x2002:00"
    assert "it may have been executed" in str(error_of(pair, write(pair.remote, "limited", 11)))


def test_a_length_that_is_not_the_objects() -> None:
    wide = Variable(LIMITED, 0, "wide", DataType.UNSIGNED32)
    pair = Pair(ObjectDictionary([standard_object(0x1000), Object.of("wide", [wide])]))
    remote = RemoteNode(pair.master.out, 5, io_device())
    pair.master.detach(pair.remote)
    pair.master.attach(remote)
    error = error_of(pair, read(remote, "limited"))
    assert isinstance(error, UnexpectedLengthError)
    assert "is it described by another device's dictionary?" in str(error)
