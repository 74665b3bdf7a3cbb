"""A recording of a hand as a Rerun file, without a robot."""

import os
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from pydrake.math import RigidTransform

from geort_drake.colours import FINGER_COLOURS, SKIN, rgb
from geort_drake.export.episode import newest
from geort_drake.people.coverage import tip_distances
from geort_drake.people.keypoints import FINGER_NAMES
from geort_drake.people.recording import Recording
from geort_drake.rerun.file import Recording as RerunFile
from geort_drake.rerun.hand import HandTrack
from geort_drake.rerun.scene import Scene
from geort_drake.rerun.tracks import SignalTrack, StateTrack, Track


def write_hand(
    recording: Recording,
    path: str | os.PathLike,
    fps: float = 30.0,
    states: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Writes the hand as it moves in its wrist frame H, and how far the thumb's tip is from the others.

    Args:
        recording: of the hand.
        path: .rrd to write.
        fps: frames per second; each holds the newest sample.
        states: name of a lane → what is going on in each frame of the recording.
    """
    t = recording.t - recording.t[0]
    times = np.arange(int(t[-1] * fps + 1e-6) + 1) / fps
    rows = newest(t, times)
    p_HK = np.where(recording.valid[:, None, None], recording.p_HK.astype(float), np.nan)[rows]
    others = FINGER_NAMES[1:]
    tracks: list[Track] = [
        HandTrack("human", SKIN, RigidTransform()),
        SignalTrack(
            "gap/thumb",
            others,
            title="thumb's tip to that of",
            unit="mm",
            legend=True,
            colors=[rgb(FINGER_COLOURS[finger]) for finger in others],
        ),
    ]
    # For each track the values of its ports; a hand that is lost is not a number.
    samples: list[Iterable[tuple]] = [
        ((keypoints, RigidTransform()) for keypoints in p_HK),
        ((gaps,) for gaps in 1e3 * tip_distances(p_HK)),
    ]
    for key, what in (states or {}).items():
        labels = list(dict.fromkeys(what))
        tracks.append(StateTrack(key, dict(enumerate(labels))))
        samples.append([([labels.index(what[row])],) for row in rows])
    facts = {key: value for key, value in recording.metadata.items() if isinstance(value, str | int | float)}
    file = RerunFile(
        path,
        Scene(paths=[]),
        tracks,
        application_id="geort_drake_hand",
        recording_id=None,
        properties=facts,
        blueprint=None,
    )
    for time, *sample in zip(times, *samples, strict=True):
        file.append(float(time), sample)
    file.close()
