"""The map for everyone: one network that takes fingertips and the code of a person."""

from geort_drake.retargeting.method import ShippedMethod
from geort_drake.retargeting.methods.universal.config import UniversalConfig

__all__ = ["METHODS", "UniversalConfig"]

METHODS = (ShippedMethod("universal", "one map for every person, shipped for the hand"),)
