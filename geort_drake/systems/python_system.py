"""A base class for systems in Python that are freed with their diagram."""

import weakref
from collections.abc import Callable
from typing import Any

from pydrake.systems import framework


def weak_callback(system: framework.System, callback: Callable) -> Callable:
    """Keeps a callback as part of a system in Python, and returns a weak reference that Drake can call."""
    system.__dict__.setdefault("_callbacks", []).append(callback)
    reference = weakref.ref(callback)

    def call(*arguments: Any) -> Any:  # Drake 1.58 takes no weakref.proxy
        return reference()(*arguments)  # type: ignore[misc]

    return call


def _with_weak_callbacks(name: str) -> Callable:
    declare = getattr(framework.LeafSystem, name)

    def declare_weakly(self: "PythonSystem", *arguments: Any, **options: Any) -> Any:
        arguments = tuple(weak_callback(self, one) if callable(one) else one for one in arguments)
        options = {key: weak_callback(self, one) if callable(one) else one for key, one in options.items()}
        return declare(self, *arguments, **options)

    declare_weakly.__doc__ = declare.__doc__
    return declare_weakly


_SystemType: Any = type(framework.System)
if _SystemType.__name__ == "pybind11_type":

    class Freeable(_SystemType):
        """Metaclass of systems that add no dictionary to pydrake's: Python 3.11 would never free them.

        Its garbage collector would visit the dictionary twice, and so count more references than there are.
        """

        def __new__(mcs, name: str, bases: tuple, namespace: dict, **options: Any) -> type:
            namespace.setdefault("__slots__", ())
            return super().__new__(mcs, name, bases, namespace, **options)

else:  # newer releases of Drake use nanobind, which does not need it
    Freeable = _SystemType  # type: ignore[misc]


class PythonSystem(framework.LeafSystem, metaclass=Freeable):
    """A LeafSystem that Python's garbage collector frees with its diagram.

    A class derived from Drake's LeafSystem, with output ports, is never freed, nor is its diagram
    (drake#22515, drake#24162): callbacks are kept in C++, where the garbage collector does not see that they
    refer to the system. Here the system keeps them, and Drake gets weak references.

    An attribute must not hold what pydrake returns as a part of the same diagram, other than systems and
    ports: a body, a frame, a shape or a cache entry keeps the diagram alive as invisibly. Hold its index or a
    copy.
    """

    DeclareAbstractOutputPort = _with_weak_callbacks("DeclareAbstractOutputPort")
    DeclareVectorOutputPort = _with_weak_callbacks("DeclareVectorOutputPort")
