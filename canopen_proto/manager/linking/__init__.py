"""PDO linking: "this node's object feeds that node's object; the master wants these objects; the master sends these".

`plan_links` computes the PDOs for such wishes, checked against the devices' files: CAN-IDs, mappings, transmission types, times,
and the downloads (concise DCF, CiA 302-3) that set them up. See plan.py."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.manager.linking.model import MASTER as MASTER
    from canopen_proto.manager.linking.model import End as End
    from canopen_proto.manager.linking.model import KnownNode as KnownNode
    from canopen_proto.manager.linking.model import Link as Link
    from canopen_proto.manager.linking.model import LinkedPdo as LinkedPdo
    from canopen_proto.manager.linking.model import LinkError as LinkError
    from canopen_proto.manager.linking.model import LinkPlan as LinkPlan
    from canopen_proto.manager.linking.model import LinkProblem as LinkProblem
    from canopen_proto.manager.linking.model import Timing as Timing
    from canopen_proto.manager.linking.plan import plan_links as plan_links
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
