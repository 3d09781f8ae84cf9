"""Understand the traffic of a bus by listening only: no frame is sent, and nothing is known except what was heard."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.observer.bus_view import BusFigures as BusFigures
    from canopen_proto.observer.bus_view import BusView as BusView
    from canopen_proto.observer.bus_view import NodeFigures as NodeFigures
    from canopen_proto.observer.finding import BusFinding as BusFinding
    from canopen_proto.observer.meaning import Meaning as Meaning
    from canopen_proto.observer.observer import Observation as Observation
    from canopen_proto.observer.observer import Observer as Observer
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
