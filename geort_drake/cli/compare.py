"""Commands that compare methods: by metrics on recordings, and side by side in Rerun."""

import itertools
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from geort_drake.cli.base import (
    SEED,
    STDOUT,
    Check,
    Command,
    HandName,
    Json,
    OutputFile,
    Seed,
    finish,
    methods_epilog,
    options,
    view,
    write_json,
)


@options
class Evaluate(Command):
    """Compare retargeting methods by how well they follow recorded hands.

      geort-drake evaluate --recording alex.npy --methods geort anyteleop --json table.json

    protocols:
      same person      always: train and score on --recording, as in the paper
      held-out blocks  --held-out K: cut the recording into K blocks; score each with a method trained on the
                       others, except for one second on either side of the block
      another person   --score-on FILE ...: train on --recording, score on the other files

    K blocks need K more trainings per seed. Trainings are cached, so that the same command resumes an
    interrupted run and only repeats the scoring. --json is rewritten after each method. A map is scored by
    the protocols that fit its training.

    Online methods start from rest in every recording and block, and process the frames in order. For metrics
    on hands that were not recorded, they start at the nearest frame, and get the same hand until their output
    has settled.

    Exit codes: 0 success; 1 a method could not be scored; 2 the input is invalid.
    """

    recording: Annotated[Path, arg(metavar="FILE")]
    """recording to train on"""
    hand: HandName = "allegro_right"
    held_out: Annotated[int | None, arg(metavar="K")] = None
    """also score on K held-out blocks, for example 5"""
    score_on: Annotated[tuple[Path, ...], arg(metavar="FILE ...")] = ()
    """also score on recordings of other people"""
    methods: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """methods listed above, maps or Python files (default: all)"""
    seeds: Annotated[tuple[int, ...], arg(metavar="SEED ..."), SEED] = (0,)
    """seeds of training and metrics; with several, shows mean and worst"""
    frames: Annotated[int | None, arg(metavar="N"), Check(lambda number: number >= 10, "at least 10")] = None
    """score only the first N valid frames of each recording and block (default: all)"""
    json: Json = None

    epilog = staticmethod(methods_epilog)

    def run(self) -> int:
        from geort_drake import Hand, read_recording
        from geort_drake.console import console, progress_bar, warn
        from geort_drake.methods import methods_for, names_of
        from geort_drake.metrics.compare import (
            HELD_OUT,
            OTHER_PERSON,
            SAME_PERSON,
            Comparison,
            Row,
            failures,
            held_out,
            other_person,
            report,
            tables,
        )

        hand = Hand(self.hand)
        methods = list(dict.fromkeys(self.methods or methods_for(hand)))
        names_of(methods, hand)  # refuses unusable ones before anything is trained
        seeds = list(dict.fromkeys(self.seeds))
        recording = read_recording(self.recording, hand.description.side, training=True)
        protocols = {SAME_PERSON: {self.recording.name: (recording, recording)}}
        if self.held_out is not None:
            protocols[HELD_OUT] = held_out(recording, self.held_out)
        if self.score_on:
            others = {str(path): read_recording(path, hand.description.side) for path in self.score_on}
            protocols[OTHER_PERSON] = other_person(recording, others)
        comparison = Comparison(hand, protocols, seeds, self.frames)
        rows: list[Row] = []
        done, total = itertools.count(), comparison.cases_per_method * len(methods)
        with progress_bar() as display:
            update = display.counter("evaluation")
            for name in methods:
                rows += comparison.run(name, lambda note: update(next(done), total, note))
                draft = report(comparison, rows, recording, self.recording.name)
                write_json(self.json, draft, done=False)
            update(total, total)
        for table in tables(comparison, rows):
            console.print(table)
        for line in failures(rows):
            warn(f"not scored: {line}")
        write_json(self.json, report(comparison, rows, recording, self.recording.name))
        if self.json is None:
            console.print("Nothing was written; --json FILE saves the figures.")
        finish({} if self.json in (None, STDOUT) else {"Figures": self.json})
        return 1 if any(failures(rows)) else 0


@options
class Explore(Command):
    """Show retargeting methods side by side on a recorded hand, in Rerun.

      geort-drake explore --recording alex.npy --methods universal geort --output explore.rrd
      rerun explore.rrd

    The Rerun recording shows the human hand, the robot hand with each method, closed and missed pinches,
    collisions, and plots of motion, pinches and posture over time. Methods that need training are trained on
    the whole recording, and cached. The universal map measures the person in the recording's first second.
    """

    recording: Annotated[Path | None, arg(metavar="FILE")] = None
    """recording of a hand (default: synthetic play)"""
    methods: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ("universal", "anyteleop")
    """methods listed above, maps or Python files"""
    output: Annotated[Path, arg(metavar="FILE"), OutputFile(".rrd")] = Path("explore.rrd")
    """Rerun recording to write (.rrd)"""
    hand: HandName = "allegro_right"
    start: Annotated[float | None, arg(metavar="S")] = None
    """start time, s (default: the part with the most pinches)"""
    duration: Annotated[float, arg(metavar="S"), Check(lambda s: 0.1 <= s <= 600, "from 0.1 to 600")] = 20.0
    """duration, s, from 0.1 to 600"""
    seed: Seed = 0
    """seed of training and synthetic play"""

    epilog = staticmethod(methods_epilog)

    def run(self) -> int:
        from geort_drake import Hand
        from geort_drake.console import track
        from geort_drake.methods import is_own, names_of, resolve
        from geort_drake.metrics.evaluation import adapt
        from geort_drake.metrics.explorer import excerpt, response, write_exploration
        from geort_drake.retargeting.train import training_recording

        hand = Hand(self.hand)
        names = names_of(self.methods, hand)
        recording = training_recording(self.recording, hand.description.side, self.seed)
        hands = excerpt(recording, duration_s=self.duration, start_s=self.start)
        # A user's own methods are examined before others are trained.
        own = {name: resolve(method, hand, recording)[0] for name, method in names.items() if is_own(method)}
        methods = {}
        for name, method in track("retargeting", names.items(), len(names), lambda item: item[0]):
            retarget = own[name] if name in own else resolve(method, hand, recording, self.seed)[0]
            methods[name] = response(adapt(retarget, recording), hand, hands)
        properties = {
            "hand": hand.description.name,
            "methods": ", ".join(methods),
            "recording": self.recording.name if self.recording else "synthetic play",
            "recording_sha256": recording.digest,
            "start_s": hands.metadata["start_s"],
            "seed": self.seed,
        }
        write_exploration(self.output, hand, hands, methods, properties)
        finish({"Recording": self.output}, view(self.output))
        return 0
