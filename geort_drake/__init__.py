"""GeoRT hand retargeting, built and judged inside a Drake simulation."""

__version__ = "0.1.0"
