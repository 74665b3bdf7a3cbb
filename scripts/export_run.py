"""Writes the trials of a run, or a recording of a hand, in formats of other programs.

parquet: a folder with a table of frames for each trial, and one of all trials and their outcomes
lerobot: a LeRobot dataset (version 3.0), an episode for each trial
rrd:     a Rerun recording of a hand; a run's trials are such recordings already
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from geort_drake.cli.console import console, progress_bar, run_main
from geort_drake.cli.options import add_json_option, at_least, command, make_parser, write_json
from geort_drake.errors import OutputError
from geort_drake.files import require_writable
from geort_drake.people.recording import SIDES

FORMATS = ("parquet", "lerobot", "rrd")
EPILOG = """\
docs/data_formats.md lists the columns of both kinds of tables.
"""


def main(argv: Sequence[str] | None = None) -> None:
    arguments = parse_arguments(argv)
    # Imported after parsing, so that --help answers at once.
    from geort_drake.export.episode import RESULTS, episode_of, read_episodes
    from geort_drake.export.lerobot import write_lerobot
    from geort_drake.export.parquet import write_parquet
    from geort_drake.people.readers import read_recording

    source, output = arguments.input, arguments.output
    is_run = (source / RESULTS).is_file()
    names = [source.stem]
    if arguments.format == "rrd":
        if is_run:
            raise OutputError(f"{source}: the trials of a run are Rerun recordings already: {source}/*.rrd")
        from geort_drake.rerun.hand_recording import write_hand

        write_hand(read_recording(source, arguments.side), output, arguments.fps or 30)
    else:
        # What is no recording's file is taken for a run, so that the message says what a run lacks.
        if is_run or not source.exists():
            episodes = read_episodes(source)
        else:
            episodes = iter([episode_of(read_recording(source, arguments.side), source.stem)])
        if arguments.format == "lerobot":
            done = write_lerobot(episodes, output, arguments.fps)
        else:
            done = write_parquet(episodes, output)
        names = []
        with progress_bar() as progress:
            task = progress.add_task("exporting", total=None, note="")
            for name in done:
                names.append(name)
                progress.update(task, advance=1, note=name)
    write_json(arguments.json, {"format": arguments.format, "output": str(output), "episodes": names})
    console.print(f"Exported: {output} ({len(names)} episodes)", markup=False, soft_wrap=True)
    console.print(_how_to_open(arguments.format, output), markup=False, soft_wrap=True)


def _how_to_open(format: str, output: Path) -> str:
    if format != "parquet":
        return f"Watch it: {command('rerun', output)}"
    return f'Read it: pyarrow.dataset.dataset("{output / "frames"}").to_table()'


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = make_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("input", type=Path, help="folder that simulate_grasp.py wrote, or a recording of a hand")
    add("output", type=Path, help="folder to write; for rrd a file")
    add("--format", choices=FORMATS, default="parquet", help="what to write")
    add(
        "--fps",
        type=at_least(1),
        help="frames per second of lerobot and rrd (default: the recording's, and 30 of rrd)",
    )
    add("--side", choices=SIDES, default="right", help="which hand was recorded")
    add_json_option(parser, "what was exported")
    arguments = parser.parse_args(argv)
    if arguments.format == "rrd" and arguments.output.suffix != ".rrd":
        parser.error(f"{arguments.output}: the name must end with .rrd")
    if arguments.format == "parquet" and arguments.fps:
        parser.error("--fps: Parquet keeps every sample; it is for lerobot and rrd")
    require_writable(arguments.output, directory=arguments.format != "rrd")
    return arguments


if __name__ == "__main__":
    run_main(main)
