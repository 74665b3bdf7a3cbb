"""GeoRT hand retargeting: human fingertips to robot joint angles, judged in a Drake simulation.

Retargeters:
    load_retargeter: loads a trained map as a `Retargeter`; needs only NumPy and safetensors.
    Retargeter: maps 21 human keypoints to robot joint angles.
    train_map: trains a `Retargeter` on a recording.
    evaluate: computes a retargeter's metrics on a recording.
People:
    read_recording: reads a recording of a hand in any known format.
    Recording: keypoints, time stamps and wrist poses of one hand.
    synthesize_play: makes a synthetic recording of a hand at play.
Robot hands:
    load_hand: loads a hand's description by name or file.
    Hand: a hand's kinematics, geometry and limits in Drake.
    add_hand_model: adds a hand to a plant.
Systems for Drake diagrams:
    RetargetingSystem: keypoints to safe joint targets.
    GloveReplay: plays a recording.
    WristToArm: wrist poses to arm joint targets.
    ActionCorrection: corrects the hand's targets, by a guard or a policy.
Rerun:
    add_rerun_recorder: records any diagram with a plant and scene graph.
    SignalSpec, StateSpec: vector ports to record as plots, or as lanes of named states.
    HandSpec, PointsSpec, ContactSpec, CloseUpSpec: hands, points, contacts and views to record.
Simulation:
    load_scenario: loads a grasp scenario from YAML.
    make_trial_diagram: builds a scenario's diagram.
    run_trial: simulates one grasp and judges it.

Each name is imported on first use, so importing the package itself is fast.
"""

import importlib

TYPE_CHECKING = False  # as in typing, whose import would take longer than all the rest

if TYPE_CHECKING:
    from geort_drake.hands.assembly import add_hand_model as add_hand_model
    from geort_drake.hands.description import load_hand as load_hand
    from geort_drake.hands.hand import Hand as Hand
    from geort_drake.metrics.evaluation import evaluate as evaluate
    from geort_drake.people.readers import read_recording as read_recording
    from geort_drake.people.recording import Recording as Recording
    from geort_drake.people.synthetic.play import synthesize_play as synthesize_play
    from geort_drake.rerun import CloseUpSpec as CloseUpSpec
    from geort_drake.rerun import ContactSpec as ContactSpec
    from geort_drake.rerun import HandSpec as HandSpec
    from geort_drake.rerun import PointsSpec as PointsSpec
    from geort_drake.rerun import SignalSpec as SignalSpec
    from geort_drake.rerun import StateSpec as StateSpec
    from geort_drake.rerun import add_rerun_recorder as add_rerun_recorder
    from geort_drake.retargeting.base import Retargeter as Retargeter
    from geort_drake.retargeting.store import load_retargeter as load_retargeter
    from geort_drake.retargeting.train import train_map as train_map
    from geort_drake.simulation.diagram import make_trial_diagram as make_trial_diagram
    from geort_drake.simulation.scenario_files import load_scenario as load_scenario
    from geort_drake.simulation.trial import run_trial as run_trial
    from geort_drake.systems.corrections import ActionCorrection as ActionCorrection
    from geort_drake.systems.glove import GloveReplay as GloveReplay
    from geort_drake.systems.retargeting_system import RetargetingSystem as RetargetingSystem
    from geort_drake.systems.wrist_to_arm import WristToArm as WristToArm

__version__ = "0.1.0"

# Public name → module that defines it.
_MODULES = {
    "ActionCorrection": "systems.corrections",
    "GloveReplay": "systems.glove",
    "Hand": "hands.hand",
    "Recording": "people.recording",
    "Retargeter": "retargeting.base",
    "RetargetingSystem": "systems.retargeting_system",
    "WristToArm": "systems.wrist_to_arm",
    "CloseUpSpec": "rerun",
    "ContactSpec": "rerun",
    "HandSpec": "rerun",
    "PointsSpec": "rerun",
    "SignalSpec": "rerun",
    "StateSpec": "rerun",
    "add_hand_model": "hands.assembly",
    "add_rerun_recorder": "rerun",
    "evaluate": "metrics.evaluation",
    "load_hand": "hands.description",
    "load_retargeter": "retargeting.store",
    "load_scenario": "simulation.scenario_files",
    "make_trial_diagram": "simulation.diagram",
    "read_recording": "people.readers",
    "run_trial": "simulation.trial",
    "synthesize_play": "people.synthetic.play",
    "train_map": "retargeting.train",
}
__all__ = list(_MODULES)


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_MODULES])
