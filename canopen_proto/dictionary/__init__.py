"""The object dictionary: its description (`model`), and one device's memory for it (`values`)."""

from canopen_proto.dictionary.model import (
    Access,
    Constant,
    ConstantNotFound,
    Direction,
    Filler,
    Key,
    Message,
    NotInDictionary,
    Object,
    ObjectDictionary,
    ObjectNotFound,
    ObjectType,
    PdoDescription,
    PdoNotFound,
    Variable,
)
from canopen_proto.dictionary.values import Values

__all__ = [
    "Access",
    "Constant",
    "ConstantNotFound",
    "Direction",
    "Filler",
    "Key",
    "Message",
    "NotInDictionary",
    "Object",
    "ObjectDictionary",
    "ObjectNotFound",
    "ObjectType",
    "PdoDescription",
    "PdoNotFound",
    "Values",
    "Variable",
]
