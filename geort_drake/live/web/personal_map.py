"""Fits the universal map to the person at the page, and switches to the fitted map."""

import time
from collections.abc import Callable
from pathlib import Path

from pydrake.systems.framework import Context

from geort_drake.errors import GeortError
from geort_drake.live.teleoperation import Teleoperation
from geort_drake.live.web.exports import start_command
from geort_drake.live.web.guide import GuidedPlay
from geort_drake.retargeting.method import Retarget
from geort_drake.retargeting.retargeter import Retargeter
from geort_drake.systems.retargeting_status import HELD_OTHER_PERSON

DONE = {"state": "done", "text": "the map is yours"}


class Refitting:
    """Fits the universal map to a person, in a separate process with low priority.

    Args:
        recording: recording of the person's hand.
        output: directory of the result.
        hand: name or file of the robot hand's description.
        map_file: file of the universal map.
    """

    def __init__(self, recording: Path, output: Path, hand: str, map_file: Path):
        self.output = output
        self._process = start_command("refit", recording, output, "--hand", hand, "--map", map_file)

    def state(self) -> dict[str, str]:
        """Returns the state of the fit for the page."""
        code = self._process.poll()
        if code is None:
            return {"state": "running", "text": "the map is being fitted to your hand"}
        if code == 0:
            return DONE
        assert self._process.stderr is not None
        return {"state": "failed", "text": self._process.stderr.read().strip()[-300:] or "the fit failed"}

    def close(self) -> None:
        """Ends the process."""
        self._process.kill()
        self._process.communicate()


class PersonalMap:
    """The map in use, which the person at the page may fit; another person gets the first map again.

    Attributes:
        state: state of the fit for the page; None before the first fit.

    Args:
        retargeter: the first map: a checkpoint, or the file of a universal map, which can be fitted.
        load: loads a retargeter from the directory of a fitted map.
    """

    def __init__(self, retargeter: Path, load: Callable[[Path], Retarget]):
        self._retargeter, self._load = retargeter, load
        self.state: dict[str, str] | None = None
        self._fit: Refitting | None = None
        self._fitted: tuple[Path, Retargeter] | None = None
        self._takes_over = False

    @property
    def is_fitted(self) -> bool:
        """Whether the map in use was fitted to the person."""
        return self._fitted is not None

    @property
    def file(self) -> Path:
        """File or directory of the map in use."""
        return self._fitted[0] if self._fitted else self._retargeter

    def begin_session(self) -> None:
        """Makes a fitted map take over in the new session, too."""
        self._takes_over = self.is_fitted

    def begin_fit(self, guide: GuidedPlay | None, hand: str, folder: Path) -> None:
        """Begins a fit to finished guided play; if that is not possible, `state` says why.

        Args:
            guide: the person's guided play, if there was any.
            hand: name or file of the robot hand's description.
            folder: folder for the play's recording and the fitted map.
        """
        if self._fit is not None:
            return
        if self._retargeter.is_dir():
            return self._refuse("only the universal map can be fitted; start without --retargeter")
        if guide is None or guide.seconds_left > 0.0:
            return self._refuse("guided play comes first")
        path = folder / time.strftime("%Y-%m-%dT%H-%M-%S-guided.npz")
        try:
            guide.recording().save(path)
        except (GeortError, IndexError) as error:
            return self._refuse(str(error))
        self._fit = Refitting(path, path.with_suffix(""), hand, self._retargeter)

    def step(self, loop: Teleoperation, root: Context) -> None:
        """Checks the fit, gives its map to the loop once per session, and drops it for another person."""
        if self._fit is not None:
            self.state = self._fit.state()
            if self.state == DONE:
                fitted = self._load(self._fit.output)
                assert isinstance(fitted, Retargeter)
                self._fitted, self._takes_over = (self._fit.output, fitted), True
            if self.state["state"] != "running":
                self._fit = None
        if self._fitted is None:
            return
        if self._takes_over:
            loop.change_map(root, self._fitted[1])
            self._takes_over = False
        elif loop.state(root) == HELD_OTHER_PERSON:
            self._fitted = None

    def close(self) -> None:
        """Ends a running fit."""
        if self._fit is not None:
            self._fit.close()

    def _refuse(self, reason: str) -> None:
        self.state = {"state": "failed", "text": reason}
