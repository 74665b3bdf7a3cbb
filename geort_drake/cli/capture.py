"""Show the capture protocol: five minutes of hand motion to record, step by step."""

import argparse

from geort_drake.cli.options import CommandParser, command, finish, output_file, view


def add_arguments(parser: CommandParser) -> None:
    add = parser.add_argument
    add("--output", type=output_file(".rrd"), help="Rerun recording of the synthetic hand to write (.rrd)")
    add(
        "--recording",
        type=output_file(".npz"),
        help="recording of the synthetic hand's keypoints to write (.npz)",
    )
    parser.add_seed("the demonstration")


def run(arguments: argparse.Namespace) -> int:
    from geort_drake.console import print_table
    from geort_drake.people.synthetic.protocol import STEPS, demonstrate

    rows, begin = [], 0.0
    for step in STEPS:
        start = f"{begin // 60:.0f}:{begin % 60:02.0f}"
        rows.append((start, f"{step.seconds:g} s", step.name, step.instruction))
        begin += step.seconds
    print_table(("start", "time", "step", "what to do"), rows, text=("step", "what to do"))
    if arguments.output is None and arguments.recording is None:
        finish({}, command("capture", "--output", "capture.rrd"))
        return 0
    recording, names = demonstrate(arguments.seed)
    written = {}
    if arguments.recording is not None:
        recording.save(arguments.recording)
        written["Recording"] = arguments.recording
    if arguments.output is not None:
        from geort_drake.export.hand_recordings import write_hand

        write_hand(recording, arguments.output, states={"step": names})
    finish(written, view(arguments.output))
    return 0
