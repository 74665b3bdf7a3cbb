"""Exports episodes as Parquet and LeRobot datasets, and hands as Rerun recordings."""
