"""Gates: is a task neither too hard nor too easy, before any method is tried?

python studies/gates.py --task keys --seeds 20 --json gates.json

Printed, and written to --json: successes of a scripted robot without a person, which must be at least 18 of
20; successes of a person with a hand that holds still, at most 1 of 20; and mean scores of an affine map
with inverse kinematics in which every fingertip also moves by a fraction of its neighbours' motion, 0 to
0.75, which must not rise with the fraction, for each kind of person, with their times to press.
"""

import argparse
import functools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from geort_drake.comparison.retargeters import retargeter_of
from geort_drake.console import run_main
from geort_drake.files import write_text
from geort_drake.hands.description import load_hand
from geort_drake.hands.model import HandModel
from geort_drake.people.human_hand import HumanHand
from geort_drake.people.play import synthesize_play
from geort_drake.people.recording import Recording
from geort_drake.simulation.free_play import seen_fingertips
from geort_drake.simulation.scenario import Scenario, load_scenario
from geort_drake.simulation.tasks import find_task
from geort_drake.simulation.tasks.keys.planner import KeysPlan, KeysPlanner
from geort_drake.simulation.trial import run_trial
from geort_drake.simulation.world import ARM, HAND, actuated_joints, add_robot
from geort_drake.simulation.wrist_motion import minimum_jerk

FRACTIONS = (0.0, 0.25, 0.5, 0.75)
MOVE = 0.3  # s, of the scripted hand


class ScriptedKeys(LeafSystem):
    """Moves a hand between the planned postures above and on the keys.

    Input ports:
        cue (1): number of the key to press, from 1; 0 for none.
    Output ports:
        desired_state (2n): joint positions and velocities in actuator order.
    """

    def __init__(self, plan: KeysPlan, start: np.ndarray, order: list[int]):
        super().__init__()
        postures = [start, plan.q_open[order], *(q[order] for q in plan.q_pressed)]
        cue = self.DeclareVectorInputPort("cue", 1)
        # Where the last movement began, its posture's number, and when.
        state = self.DeclareDiscreteState(np.array([*start, 0.0, 0.0]))
        n = len(start)

        def position(context: Context) -> np.ndarray:
            memory = context.get_discrete_state(state).value()
            share = minimum_jerk(
                (context.get_time() - memory[n + 1]) / (3 * MOVE if memory[n] == 1 else MOVE)
            )
            return memory[:n] + share * (postures[int(memory[n])] - memory[:n])

        def update(context: Context, values) -> None:
            memory, t = context.get_discrete_state(state).value(), context.get_time()
            wanted = 1 + round(cue.Eval(context)[0])
            # A press is held for a moment, and released before its cue ends.
            if memory[n] > 1 and t - memory[n + 1] > 2 * MOVE:
                wanted = 1
            elif memory[n] == 1 and wanted > 1 and t - memory[n + 1] < 6 * MOVE:
                wanted = 1
            if wanted != memory[n]:
                values.set_value(state, np.array([*position(context), wanted, t]))

        def output(context: Context, vector: BasicVector) -> None:
            vector.SetFromVector(np.concatenate([position(context), np.zeros(n)]))

        self.DeclareVectorOutputPort("desired_state", 2 * n, output)
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, update)


def scripted(scenario: Scenario, plan: KeysPlan, seed: int) -> float:
    """Score of the scripted robot."""
    description = load_hand(scenario.hand)
    builder = DiagramBuilder()
    robot, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    add_robot(robot, scenario, description)
    robot.Finalize()
    base = robot.GetFrameByName(description.base_frame, robot.GetModelInstanceByName(HAND))
    X_WB = base.CalcPoseInWorld(robot.CreateDefaultContext())
    rng = np.random.default_rng(seed)
    stage = find_task("keys").add_stage(builder, scenario, description, plan.goal, X_WB, rng)
    plant, hand, arm = stage.scene.plant, stage.scene.hand, stage.scene.arm
    joints = actuated_joints(plant, hand)
    order = [description.joint_names.index(joint.name()) for joint in joints]
    start = np.array([joint.default_positions()[0] for joint in joints])
    script = builder.AddSystem(ScriptedKeys(plan, start, order))
    builder.Connect(stage.monitor.GetOutputPort("cue"), script.GetInputPort("cue"))
    builder.Connect(script.GetOutputPort("desired_state"), plant.get_desired_state_input_port(hand))
    still = builder.AddSystem(ConstantVectorSource(np.zeros(2 * plant.num_actuated_dofs(arm))))
    builder.Connect(still.get_output_port(), plant.get_desired_state_input_port(arm))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    stage.initialize(root)
    for index in plant.GetJointIndices(plant.GetModelInstanceByName(ARM)):
        plant.get_joint(index).Lock(plant.GetMyMutableContextFromRoot(root))
    simulator.AdvanceTo(scenario.timeout)
    outcome = stage.monitor.outcome(stage.monitor.GetMyContextFromRoot(root))
    return outcome.score if outcome.success else 0.0


class CrossTalk:
    """A map in which every fingertip also moves by a fraction of its neighbours' mean motion."""

    def __init__(self, retarget, rest: np.ndarray, keypoints: Sequence[int], fraction: float):
        self._retarget, self._rest, self._keypoints = retarget, rest, list(keypoints)
        self._fraction, self.joint_names = fraction, retarget.joint_names

    def __call__(self, p_HK: np.ndarray) -> np.ndarray:
        p_HF = p_HK[self._keypoints]
        moved = (p_HF - self._rest)[1:]
        others = (moved.sum(axis=0) - moved) / (len(moved) - 1)
        mixed = p_HF.copy()
        mixed[1:] += self._fraction * others
        return self._retarget(mixed)


@functools.cache
def setting(hand_name: str) -> tuple[HandModel, Recording, HumanHand, list]:
    """The robot hand, the person's play and hand, and the places of the keys."""
    hand = HandModel(load_hand(hand_name))
    recording = synthesize_play(seed=0, side=hand.description.side)
    plans = find_task("keys").plans(load_scenario(hand=hand_name), hand.description)
    return hand, recording, HumanHand.fit(recording), plans


def trial(kind: str, method: str, fraction: float, seed: int, hand_name: str) -> dict:
    """Record of one trial of a person with the affine map, or with a hand that holds still."""
    task = find_task("keys")
    scenario = load_scenario(*task.scenario, hand=hand_name)
    scenario.kind, scenario.random_seed = kind, seed
    hand, recording, person, plans = setting(hand_name)
    retarget, _ = retargeter_of(method, hand, recording, 0, lambda *_: Path())
    if fraction:
        keypoints = hand.description.human_keypoints
        retarget = CrossTalk(retarget, recording.fingertips(keypoints).mean(axis=0), keypoints, fraction)
    goal, _ = task.keep(plans, seen_fingertips(retarget, hand, person))
    result, _ = run_trial(scenario, retarget, (person, goal))
    return {"kind": kind, "method": method, "fraction": fraction, **result.to_json()}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="keys", choices=["keys"], help="task with gates")
    parser.add_argument("--hand", default="allegro_right", help="name or file of a hand description")
    parser.add_argument("--seeds", type=int, default=20, help="of the scripted robot and the still hand")
    parser.add_argument("--map-seeds", type=int, default=2, help="of each affine map and kind of person")
    parser.add_argument("--json", type=Path, help="where to write the figures")
    arguments = parser.parse_args(argv)
    task = find_task(arguments.task)
    scenario = load_scenario(*task.scenario, hand=arguments.hand)
    plan = KeysPlanner(load_hand(arguments.hand)).plans()[0]
    scores = [scripted(scenario, plan, seed) for seed in range(arguments.seeds)]
    done = sum(score > 0 for score in scores)
    print(f"scripted robot: {done} of {len(scores)}; wanted at least {0.9 * len(scores):.0f}", flush=True)
    wanted = [(task.kinds[0], "hold", 0.0, seed, arguments.hand) for seed in range(arguments.seeds)]
    wanted += [
        (kind, "affine_ik", fraction, seed, arguments.hand)
        for seed in range(arguments.map_seeds)
        for kind in task.kinds
        for fraction in FRACTIONS
    ]
    records = [trial(*each) for each in wanted]
    held = [record for record in records if record["method"] == "hold"]
    successes = sum(record["success"] for record in held)
    print(f"hold: {successes} of {len(held)}; wanted at most {0.05 * len(held):.0f}")
    ordered = {}
    for kind in task.kinds:
        own = [[r for r in records if r["method"] == "affine_ik" and r["kind"] == kind and r["fraction"] == f]
               for f in FRACTIONS]  # fmt: skip
        means = [float(np.mean([r["score"] for r in group])) for group in own]
        times = [float(np.mean([r["press_time"] or np.inf for r in group])) for group in own]
        ordered[kind] = {"score": means, "press_time": times}
        right = all(np.diff(means) <= 0) and means[-1] < means[0]
        shown = ", ".join(f"{mean:.2f} ({time:.2f} s)" for mean, time in zip(means, times, strict=True))
        print(f"affine maps, {kind}: {shown}; ordered: {right}")
    figures = {"scripted": scores, "hold": [r["score"] for r in held], "affine": ordered, "records": records}
    if arguments.json:
        write_text(arguments.json, json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
