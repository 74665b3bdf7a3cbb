"""Parquet, LeRobot datasets and Rerun recordings of hands."""
