"""The former name of `Hand`, for modules that still use it."""

from geort_drake.hands.hand import Hand as HandModel

__all__ = ["HandModel"]
