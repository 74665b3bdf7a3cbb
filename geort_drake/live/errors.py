"""What can go wrong between a glove, this program and a robot."""

from geort_drake.errors import GeortError


class LiveError(GeortError):
    """A message cannot be used, or a glove or robot is missing or does not answer."""


class MismatchError(LiveError):
    """The other side speaks another version or unit, or is of another hand; waiting does not help."""
