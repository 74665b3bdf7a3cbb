"""The command that shows methods side by side."""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from geort_drake.cli.base import (
    Check,
    Command,
    HandName,
    OutputFile,
    Seed,
    finish,
    methods_epilog,
    options,
    view,
)


@options
class Explore(Command):
    """Show retargeting methods side by side on a recorded hand, in Rerun.

      geort-drake explore --recording alex.npy --methods universal geort --output explore.rrd
      rerun explore.rrd

    The recording shows the human hand, the robot hand with each method, the losses over time, closed and
    missed pinches, and collisions. Methods that need training are trained on the whole recording and cached.
    The universal map is measured from the recording's first second.
    """

    recording: Annotated[Path | None, arg(metavar="FILE")] = None
    """recording of a hand (default: synthetic play)"""
    methods: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ("universal", "anyteleop")
    """methods listed below, maps or Python files"""
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
        from geort_drake import Hand, load_hand
        from geort_drake.console import track
        from geort_drake.methods import names_of, resolve
        from geort_drake.metrics.evaluation import adapted
        from geort_drake.metrics.exploration import excerpt, response
        from geort_drake.metrics.explorer_recording import write_exploration
        from geort_drake.retargeting.train import training_recording

        description = load_hand(self.hand)
        hand = Hand(description)
        names = names_of(self.methods, hand=hand)
        recording = training_recording(self.recording, description.side, self.seed)
        hands = excerpt(recording, duration_s=self.duration, start_s=self.start)
        methods = {}
        for name, method in track("retargeting", names.items(), len(names), lambda item: item[0]):
            retarget, _ = resolve(method, hand, recording, self.seed)
            methods[name] = response(adapted(retarget, recording), hand, hands)
        properties = {
            "hand": description.name,
            "methods": ", ".join(methods),
            "recording": self.recording.name if self.recording else "synthetic play",
            "recording_sha256": recording.digest,
            "start_s": hands.metadata["start_s"],
            "seed": self.seed,
        }
        write_exploration(self.output, hand, hands, methods, properties)
        finish({"Recording": self.output}, view(self.output))
        return 0
