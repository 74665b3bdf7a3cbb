"""Records Drake diagrams, or arrays without a simulation, for the Rerun viewer.

A recorder is a system in a diagram. It samples the bodies of a plant, and other ports on request:

    torque = SignalSpec(port, ["shoulder", "elbow"], unit="N m")
    recorder = add_rerun_recorder(builder, plant, scene_graph, "robot.rrd", {"torque": torque})
    simulator = Simulator(builder.Build())
    with recorder:  # leaving the block writes the file
        simulator.AdvanceTo(5.0)

`HandSpec`, `PointsSpec`, `StateSpec`, `ContactSpec` and `CloseUpSpec` add human hands, points, named states,
contact forces and views. Without a simulation, `file_writer` opens a `Writer`, whose methods send arrays over
time.
"""

from geort_drake.rerun.recorder import RerunRecorder, add_rerun_recorder
from geort_drake.rerun.scene import ContactSpec
from geort_drake.rerun.specs import CloseUpSpec, HandSpec, PointsSpec, SignalSpec, Spec, StateSpec
from geort_drake.rerun.writer import Writer, file_writer

__all__ = [
    "CloseUpSpec",
    "ContactSpec",
    "HandSpec",
    "PointsSpec",
    "RerunRecorder",
    "SignalSpec",
    "Spec",
    "StateSpec",
    "Writer",
    "add_rerun_recorder",
    "file_writer",
]
