"""Values that a context may share with its copies."""

from typing import Self


class Unchanging:
    """Of a class whose instances nobody changes once made; a copy is the same object.

    Drake copies all abstract states of a diagram twice at every update of any of them, and those that are
    Python objects with `copy.deepcopy`, which takes longer than what most systems compute.
    """

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict) -> Self:
        return self
