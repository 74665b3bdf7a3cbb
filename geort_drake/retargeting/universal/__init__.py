"""One map for everyone: `UniversalRetargeter` makes the map of a person from a few frames of their hand."""

from geort_drake.retargeting.universal.person import MEASURED_FRAMES, UniversalRetargeter

__all__ = ["MEASURED_FRAMES", "UniversalRetargeter"]
