"""What passes on a bus, for all who look at it: the last frames, what they mean, who sends what to whom."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.traffic.feed import FeedRow as FeedRow
    from canopen_gateway.traffic.feed import FrameWish as FrameWish
    from canopen_gateway.traffic.feed import TrafficFeed as TrafficFeed
    from canopen_gateway.traffic.ring import FrameRing as FrameRing
    from canopen_gateway.traffic.ring import PassedFrame as PassedFrame
    from canopen_gateway.traffic.traffic import NetTraffic as NetTraffic
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
