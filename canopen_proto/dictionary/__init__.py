"""The object dictionary: its description (`model`), and one device's memory for it (`values`)."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.dictionary.concise import ConciseError as ConciseError
    from canopen_proto.dictionary.concise import from_concise as from_concise
    from canopen_proto.dictionary.concise import pack_concise as pack_concise
    from canopen_proto.dictionary.model import Access as Access
    from canopen_proto.dictionary.model import Constant as Constant
    from canopen_proto.dictionary.model import ConstantNotFoundError as ConstantNotFoundError
    from canopen_proto.dictionary.model import Direction as Direction
    from canopen_proto.dictionary.model import Filler as Filler
    from canopen_proto.dictionary.model import Key as Key
    from canopen_proto.dictionary.model import Message as Message
    from canopen_proto.dictionary.model import NotInDictionaryError as NotInDictionaryError
    from canopen_proto.dictionary.model import Object as Object
    from canopen_proto.dictionary.model import ObjectDictionary as ObjectDictionary
    from canopen_proto.dictionary.model import ObjectNotFoundError as ObjectNotFoundError
    from canopen_proto.dictionary.model import ObjectType as ObjectType
    from canopen_proto.dictionary.model import PdoDescription as PdoDescription
    from canopen_proto.dictionary.model import PdoNotFoundError as PdoNotFoundError
    from canopen_proto.dictionary.model import Variable as Variable
    from canopen_proto.dictionary.standard import standard_object as standard_object
    from canopen_proto.dictionary.typed import ReadOnly as ReadOnly
    from canopen_proto.dictionary.typed import ReadWrite as ReadWrite
    from canopen_proto.dictionary.typed import WriteOnly as WriteOnly
    from canopen_proto.dictionary.values import Values as Values
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
