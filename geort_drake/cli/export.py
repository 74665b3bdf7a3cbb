"""Export grasp trials or a recording of a hand to Parquet, LeRobot or Rerun.

parquet: a folder with one table of frames per trial, and one table of all trials and outcomes
lerobot: a LeRobot dataset (version 3.0), one episode per trial
rrd:     a Rerun recording of a hand (the trials of a run already are Rerun recordings)
"""

import argparse
from pathlib import Path

from geort_drake.cli.options import CommandParser, at_least, finish, output_file, view, write_json
from geort_drake.errors import OutputError, UsageError
from geort_drake.files import require_writable


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("input", type=Path, help="folder that `geort-drake grasp` wrote, or a recording of a hand")
    add("output", type=Path, help="folder to write; with rrd, a file")
    add("--format", choices=("parquet", "lerobot", "rrd"), default="parquet", help="format to write")
    rate = "frames per second, for lerobot and rrd (default: the recording's; rrd: 30)"
    add("--fps", type=at_least(1), help=rate)
    parser.add_side("right")
    parser.add_json("what was exported")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake import read_recording
    from geort_drake.console import track
    from geort_drake.export.episode import RESULTS, episode_of, read_episodes
    from geort_drake.export.lerobot import write_lerobot
    from geort_drake.export.parquet import write_parquet

    source, output = arguments.input, arguments.output
    if arguments.format == "parquet" and arguments.fps:
        raise UsageError("--fps: Parquet keeps every sample; use it with lerobot and rrd")
    if arguments.format != "rrd":
        require_writable(output, directory=True)
    is_run = (source / RESULTS).is_file()
    names = [source.stem]
    if arguments.format == "rrd":
        from geort_drake.export.hand_recordings import write_hand

        output_file(".rrd")(str(output))
        if is_run:
            raise OutputError(f"{source}: the trials of a run are Rerun recordings already: {source}/*.rrd")
        write_hand(read_recording(source, arguments.side), output, arguments.fps or 30)
    else:
        # A missing input is read as a run, because that error says what a run needs.
        if is_run or not source.exists():
            episodes = read_episodes(source)
        else:
            episodes = iter([episode_of(read_recording(source, arguments.side), source.stem)])
        if arguments.format == "lerobot":
            done = write_lerobot(episodes, output, arguments.fps)
        else:
            done = write_parquet(episodes, output)
        names = list(track("exporting", done, None))
    write_json(arguments.json, {"format": arguments.format, "output": str(output), "episodes": names})
    results = {"Exported": f"{output} (episodes: {len(names)})"}
    if arguments.format == "parquet":
        results["Read it"] = f'pyarrow.dataset.dataset("{output / "frames"}").to_table()'
    finish(results, None if arguments.format == "parquet" else view(output))
    return 0
