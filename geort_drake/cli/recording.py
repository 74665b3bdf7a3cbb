"""Commands for recordings of hands: check, convert, synthesize, and show what to record."""

import contextlib
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from geort_drake.cli.base import (
    COUNT,
    POSITIVE,
    Command,
    Json,
    OutputFile,
    Seed,
    Side,
    command,
    finish,
    options,
    require_output_file,
    require_output_folder,
    view,
    write_json,
)
from geort_drake.errors import RecordingError, UsageError, naming

if TYPE_CHECKING:
    from geort_drake import Recording

_POLL_PERIOD_S = 1.0
_MAX_FRAMES = 5_000_000  # half a day at 120 Hz; needs two gigabytes of memory
_RATE_HZ = 120.0


@options
class _Reading(Command):
    """Options for reading a recording."""

    input: Positional[Path]
    """recording in one of the formats above"""
    format: Annotated[str, arg(metavar="NAME")] = "auto"
    """format, one of those above; auto detects it"""
    side: Side = "right"
    """side of the recorded hand"""
    mirror: bool = False
    """turn it into a recording of the other hand"""
    unit: Literal["m", "dm", "cm", "mm", "inch"] | None = None
    """unit of lengths in the file (default: the format's)"""
    rate: Annotated[float | None, arg(metavar="HZ"), POSITIVE] = None
    """frame rate of a file without timestamps (default: 30)"""
    json: Json = None

    @staticmethod
    def epilog() -> str:
        from geort_drake.people.formats import FORMATS

        return "formats:\n" + "\n".join(f"  {name:16} {each.title}" for name, each in FORMATS.items())

    def _read(self) -> "Recording":
        from geort_drake import read_recording

        recording = read_recording(
            self.input, self.side, format=self.format, unit=self.unit, rate_hz=self.rate
        )
        return recording.mirrored() if self.mirror else recording

    def _check(self) -> "tuple[Recording, dict[str, Any]]":
        """Reads the recording, prints the report of its faults, and returns both."""
        from geort_drake.people.coverage import figures, training_faults

        name = str(self.input)
        try:
            recording = self._read()
        except RecordingError as error:
            refusal = {"file": name, "verdict": "refused", "fit_for_training": False, "reason": str(error)}
            write_json(self.json, refusal)
            raise
        warnings, unfit = recording.metadata["warnings"], training_faults(recording)
        report = {
            "file": name,
            "verdict": "usable with warnings" if warnings or unfit else "usable",
            "fit_for_training": not unfit,
            "warnings": [*warnings, *unfit],
            **figures(recording),
        }
        _print_report(report)
        write_json(self.json, report)
        return recording, report

    def _grasp(self, recording: "Recording", path: Path) -> str:
        return command("grasp", recording=path, hand=None if recording.side == "right" else "allegro_left")


@options
class CheckRecording(_Reading):
    """Check a recording of a hand and report its faults.

    Exit codes: 0 usable, perhaps with warnings; 2 refused.
    """

    watch: bool = False
    """first show the missing motions while the file is being recorded"""

    def run(self) -> int:
        if self.watch:
            self._watch()
        recording, report = self._check()
        following = None
        if report["fit_for_training"]:
            following = self._convert() or self._grasp(recording, self.input)
        finish({}, following)
        return 0

    def _convert(self) -> str | None:
        """Returns the command that converts the file, if other commands would read it differently."""
        reading = {
            "format": self.format if self.format != "auto" else None,
            "unit": self.unit,
            "rate": self.rate,
        }
        if not self.mirror and not any(reading.values()):
            return None
        converted = self.input.with_name(f"{self.input.stem}_converted.npz")
        side = "left" if self.side == "left" else None
        flags = ["--mirror"] if self.mirror else []
        return command("recording", "convert", self.input, *flags, output=converted, **reading, side=side)

    def _watch(self) -> None:
        """Shows the motions that a growing file lacks until none is missing, or Ctrl-C."""
        last_stamp: int | None = -1  # so that a missing file is reported too
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                stamp = self.input.stat().st_mtime_ns if self.input.exists() else None
                if stamp != last_stamp and self._print_coverage():
                    return
                last_stamp = stamp
                time.sleep(_POLL_PERIOD_S)

    def _print_coverage(self) -> bool:
        """Prints the motions recorded so far and the missing ones; returns whether none is missing."""
        from geort_drake.console import console, print_table, say
        from geort_drake.people.coverage import coverage

        console.clear()
        try:
            recording = self._read()
        except RecordingError as error:
            # A file that is being written may be empty, or end within a frame.
            say(f"waiting: {error}")
            return False
        motions = coverage(recording)
        rows = [
            (
                f"[{'green' if motion['enough'] else 'red'}]{motion['motion']}[/]",
                f"{int(motion['seen'])} {motion['unit']}",
                f"{motion['required']:.0f}",
                "" if motion["enough"] else motion["advice"],
            )
            for motion in motions
        ]
        headings = ("motion", "recorded", "required", "what to do")
        print_table(headings, rows, f"{recording.duration_s:.0f} s", text=headings[3:])
        return all(motion["enough"] for motion in motions)


@options
class ConvertRecording(_Reading):
    """Convert a recording of a hand to geort-drake's own format (.npz).

    Also reports faults, as `geort-drake recording check` does.

    Exit codes: 0 usable, perhaps with warnings; 2 refused.
    """

    output: Annotated[Path, arg(metavar="FILE"), OutputFile(".npz")]
    """file to write (.npz)"""

    def run(self) -> int:
        # Path.resolve raises an error for a link to itself.
        if os.path.realpath(self.output) == os.path.realpath(self.input):
            raise UsageError(f"{self.output}: choose another file than the recording itself")
        recording, report = self._check()
        recording.save(self.output)
        following = self._grasp(recording, self.output) if report["fit_for_training"] else None
        finish({"Recording": self.output}, following)
        return 0


@options
class SynthesizeRecording(Command):
    """Generate recordings of hand motion, without a person or device.

    By default, the command makes one recording of an average adult's hand. With --people, it makes one
    recording for each of several people with different hands, habits and devices.
    """

    output: Annotated[Path, arg(metavar="PATH")]
    """recording to write (.npz), or with --people a folder for recordings"""
    seed: Seed = 0
    """seed of the motions, and of the people"""
    duration: Annotated[float, arg(metavar="S"), POSITIVE] = 300.0
    """duration, s"""
    rate: Annotated[float | None, arg(metavar="HZ"), POSITIVE] = None
    """frames per second (default: 120; with --people, the device's)"""
    people: Annotated[int | None, arg(metavar="N"), COUNT] = None
    """draw the first N people of the seed's population"""
    hand_of: Annotated[Path | None, arg(metavar="FILE")] = None
    """recording of the hand to imitate (default: an average adult's hand)"""
    side: Side = "right"
    """side of the hand"""

    def run(self) -> int:
        rate = _RATE_HZ if self.rate is None else self.rate
        if self.duration * rate > _MAX_FRAMES:
            raise UsageError(f"--duration times --rate may be at most {_MAX_FRAMES:,} frames")
        if self.people is None:
            return self._record_average_hand(rate)
        if self.hand_of is not None:
            raise UsageError("--hand-of cannot be used with --people, who have their own hands")
        return self._record_people(self.people)

    def _record_average_hand(self, rate: float) -> int:
        from geort_drake import read_recording, synthesize_play
        from geort_drake.console import warn
        from geort_drake.people.checks import examine
        from geort_drake.people.synthetic.hand import HumanHand

        require_output_file(self.output, ".npz")
        hand = None
        if self.hand_of is not None:
            person = read_recording(self.hand_of, self.side)
            with naming(self.hand_of, RecordingError):
                hand = HumanHand.fit(person)
        recording = examine(synthesize_play(self.seed, self.duration, rate, hand, side=self.side))
        recording.save(self.output)
        for sentence in recording.metadata["warnings"]:
            warn(sentence)
        size = f"{len(recording)} frames at {recording.rate_hz:g} Hz"
        finish({"Recording": f"{self.output} ({size})"}, command("grasp", recording=self.output))
        return 0

    def _record_people(self, count: int) -> int:
        from geort_drake.console import warn
        from geort_drake.people.synthetic.population import sample_person

        require_output_folder(self.output)
        paths = [self.output / f"person_{number:03d}.npz" for number in range(count)]
        for number, path in enumerate(paths):
            person = sample_person(self.seed, number)
            person.record(self.duration, self.rate, self.side).save(path)
        if others := sorted({*self.output.glob("person_*.npz")} - {*paths}):
            warn(f"{self.output}: also contains people of another run, such as {others[0].name}")
        results = {"Recordings": f"{self.output} (people: {count})"}
        finish(results, command("recording", "check", paths[0]))
        return 0


@options
class ShowProtocol(Command):
    """Show what to record: five minutes of hand motion, step by step."""

    output: Annotated[Path | None, arg(metavar="FILE"), OutputFile(".rrd")] = None
    """Rerun recording of a synthetic hand that shows the steps (.rrd)"""
    recording: Annotated[Path | None, arg(metavar="FILE"), OutputFile(".npz")] = None
    """recording of the synthetic hand's keypoints to write (.npz)"""
    seed: Seed = 0
    """seed of the demonstration"""

    def run(self) -> int:
        from geort_drake.console import print_table
        from geort_drake.people.synthetic.protocol import STEPS, demonstrate

        rows, begin = [], 0.0
        for step in STEPS:
            start = f"{begin // 60:.0f}:{begin % 60:02.0f}"
            rows.append((start, f"{step.seconds:g} s", step.name, step.instruction))
            begin += step.seconds
        print_table(("start", "time", "step", "what to do"), rows, text=("step", "what to do"))
        if self.output is None and self.recording is None:
            finish({}, command("recording", "protocol", output="protocol.rrd"))
            return 0
        recording, names = demonstrate(self.seed)
        outputs = {}
        if self.recording is not None:
            recording.save(self.recording)
            outputs["Recording"] = self.recording
        if self.output is not None:
            from geort_drake.export.hand_recordings import write_hand

            write_hand(recording, self.output, steps=names)
        finish(outputs, view(self.output))
        return 0


def _print_report(report: dict[str, Any]) -> None:
    from geort_drake.console import print_table, say, warn
    from geort_drake.people.coverage import describe
    from geort_drake.people.formats import FORMATS

    known_format = FORMATS.get(report["format"])
    kind = known_format.title if known_format else report["format"]
    rate_source = "known" if report["rate_known"] else "assumed"
    origin = f", mirrored from a {report['recorded_side']} one" if report["recorded_side"] else ""
    say(f"{report['file']}: {report['side']} hand{origin}, read as {kind}")
    say(
        f"{report['frames']} frames, {report['valid_frames']} valid, {report['duration_s']:.1f} s at "
        f"{report['rate_hz']:.1f} Hz ({rate_source}); wrist: {report['wrist']}"
    )
    rows = [
        (
            finger,
            " ".join(f"{value:5.1f}" for value in figures["bones_mm"]),
            f"{figures['bones_vary_percent']:.1f} %",
            f"{figures['speed_median_m_s']:.2f} (p95 {figures['speed_p95_m_s']:.2f})",
            "" if figures["pinch_frames"] is None else str(figures["pinch_frames"]),
        )
        for finger, figures in report["fingers"].items()
    ]
    print_table(("finger", "bones from the wrist, mm", "vary by", "speed, m/s", "pinch frames"), rows)
    for sentence in report["warnings"]:
        warn(sentence)
    missing = [motion for motion in report["coverage"] if not motion["enough"]]
    for motion in missing:
        say(f"insufficient: {describe(motion)}")
    count = len(report["coverage"])
    say(f"coverage: {count - len(missing)} of {count} motions that training needs")
    say(f"verdict: {report['verdict']}" + ("" if report["fit_for_training"] else "; not fit for training"))
