"""The command that exports trials and recordings to other formats."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from geort_drake.cli.base import (
    COUNT,
    Command,
    Json,
    Side,
    finish,
    options,
    require_output_file,
    require_output_folder,
    view,
    write_json,
)
from geort_drake.errors import OutputError, UsageError


@options
class Export(Command):
    """Export trials or a recording of a hand to Parquet, LeRobot or Rerun.

    formats:
      parquet  a folder with one table of frames per trial, and one table of all trials and outcomes
      lerobot  a LeRobot dataset (version 3.0), one episode per trial
      rrd      a Rerun recording of a hand (the trials of a run already are Rerun recordings)
    """

    input: Positional[Path]
    """folder that `geort-drake grasp` or `simulate` wrote, or a recording of a hand"""
    output: Annotated[Path, arg(metavar="PATH")]
    """folder to write; with rrd, a file"""
    format: Literal["parquet", "lerobot", "rrd"] | None = None
    """format to write (default: rrd if PATH ends so, else parquet)"""
    fps: Annotated[int | None, arg(metavar="HZ"), COUNT] = None
    """frames per second, for lerobot and rrd (default: the recording's; rrd: 30)"""
    side: Side = "right"
    """side of the recorded hand"""
    json: Json = None

    def run(self) -> int:
        from geort_drake import read_recording
        from geort_drake.console import track
        from geort_drake.export.episode import RESULTS, episode_of, read_episodes
        from geort_drake.export.hand_recordings import write_hand
        from geort_drake.export.lerobot import write_lerobot
        from geort_drake.export.parquet import write_parquet

        kind = self.format or ("rrd" if self.output.suffix == ".rrd" else "parquet")
        if kind == "parquet" and self.fps:
            raise UsageError("--fps: Parquet keeps every sample; use it with lerobot and rrd")
        is_run = (self.input / RESULTS).is_file()
        names = [self.input.stem]
        if kind == "rrd":
            require_output_file(self.output, ".rrd")
            if is_run:
                where = f"{self.input}/*.rrd"
                raise OutputError(f"{self.input}: the trials of a run are Rerun recordings already: {where}")
            write_hand(read_recording(self.input, self.side), self.output, self.fps or 30)
        else:
            require_output_folder(self.output)
            if is_run or not self.input.exists():
                episodes = read_episodes(self.input)
            else:
                episodes = iter([episode_of(read_recording(self.input, self.side), self.input.stem)])
            if kind == "lerobot":
                done = write_lerobot(episodes, self.output, self.fps)
            else:
                done = write_parquet(episodes, self.output)
            names = list(track("exporting", done, None))
        write_json(self.json, {"format": kind, "output": str(self.output), "episodes": names})
        results = {"Exported": f"{self.output} (episodes: {len(names)})"}
        if kind == "parquet":
            results["Read it"] = f'pyarrow.dataset.dataset("{self.output / "frames"}").to_table()'
        finish(results, None if kind == "parquet" else view(self.output))
        return 0
