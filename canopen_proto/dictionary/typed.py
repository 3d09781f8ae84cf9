"""Keys that know the type of their object: a type checker then knows what a read gives, and what a write takes.

    class Drive:                                     # made by `canopen eds stubs drive.eds`
        statusword = ReadOnly[int](0x6041_00)

    value = await node.read(Drive.statusword)        # an int
    await node.write(Drive.statusword, 5)            # an error of mypy and pyright

At run time a key is the multiplexer of its object, an int. To a type checker it is none: an int could be written to, whatever it
names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

from canopen_proto.datatypes import Value

T = TypeVar("T", bound=Value)
T_co = TypeVar("T_co", bound=Value, covariant=True)
T_contra = TypeVar("T_contra", bound=Value, contravariant=True)

if TYPE_CHECKING:

    class _Multiplexer:
        def __init__(self, multiplexer: int) -> None: ...

else:
    _Multiplexer = int


class ReadOnly(_Multiplexer, Generic[T_co]):
    """The key of an object that can be read."""

    __slots__ = ()


class WriteOnly(_Multiplexer, Generic[T_contra]):
    """The key of an object that can be written."""

    __slots__ = ()


class ReadWrite(_Multiplexer, Generic[T]):
    """The key of an object that can be read and written."""

    __slots__ = ()


Readable: TypeAlias = ReadOnly[T] | ReadWrite[T]
Writable: TypeAlias = WriteOnly[T] | ReadWrite[T]
