"""The text protocol of a CANopen gateway (CiA 309-3): requests, answers and events, read and written; a client's machine.

The protocol alone: canopen_gateway serves it on sockets, with a master behind it.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.gateway.answer import GatewayAnswer as GatewayAnswer
    from canopen_proto.gateway.answer import GatewayEvent as GatewayEvent
    from canopen_proto.gateway.answer import GatewayNews as GatewayNews
    from canopen_proto.gateway.answer import parse_message as parse_message
    from canopen_proto.gateway.answer import print_answer as print_answer
    from canopen_proto.gateway.answer import print_event as print_event
    from canopen_proto.gateway.client import GatewayAnswered as GatewayAnswered
    from canopen_proto.gateway.client import GatewayClient as GatewayClient
    from canopen_proto.gateway.client import GatewayLines as GatewayLines
    from canopen_proto.gateway.client import GatewayOddLine as GatewayOddLine
    from canopen_proto.gateway.codes import GatewayCode as GatewayCode
    from canopen_proto.gateway.codes import code_text as code_text
    from canopen_proto.gateway.dialect import CANOPENNODE as CANOPENNODE
    from canopen_proto.gateway.dialect import DIALECTS as DIALECTS
    from canopen_proto.gateway.dialect import LELY as LELY
    from canopen_proto.gateway.dialect import Dialect as Dialect
    from canopen_proto.gateway.node_ear import NodeEar as NodeEar
    from canopen_proto.gateway.node_ear import NodeReport as NodeReport
    from canopen_proto.gateway.pdo_port import PdoPort as PdoPort
    from canopen_proto.gateway.pdo_port import PdoReport as PdoReport
    from canopen_proto.gateway.request import GatewayCommand as GatewayCommand
    from canopen_proto.gateway.request import GatewayRequest as GatewayRequest
    from canopen_proto.gateway.request import MappedValue as MappedValue
    from canopen_proto.gateway.request_text import parse_request as parse_request
    from canopen_proto.gateway.request_text import print_request as print_request
    from canopen_proto.gateway.value_types import VALUE_TYPES as VALUE_TYPES
    from canopen_proto.gateway.value_types import ValueType as ValueType
    from canopen_proto.gateway.value_types import parse_value as parse_value
    from canopen_proto.gateway.value_types import print_value as print_value
    from canopen_proto.gateway.value_types import typed_value as typed_value
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
