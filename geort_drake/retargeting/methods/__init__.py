"""Retargeting methods that GeoRT is compared with, written from their papers."""
