"""Drake: a discrete MultibodyPlant with the SAP solver; a ball constraint joins the legs' ends. (Its continuous mode supports no loops.)"""

import importlib.metadata
from functools import partial

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from machine import BASE, COM, INERTIA, LENGTH, MASS, G, Peer, Setting, joint_torques

STEPS = (1e-3, 1e-4, 1e-5)


def peer() -> Peer:
    return Peer("Drake", importlib.metadata.version("drake"), (_setting(step) for step in STEPS))


def _plant(step: float) -> tuple:
    plant = MultibodyPlant(step)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    plant.mutable_gravity_field().set_gravity_vector([0.0, -G, 0.0])
    # Unit inertia about the link's first end: the same about all axes, except for the shift of the centre of mass.
    central, shift = INERTIA / MASS, COM**2
    inertia = SpatialInertia(MASS, [COM, 0.0, 0.0], UnitInertia(central, central + shift, central + shift))
    joints, ends = [], []
    for side, x in (("left", 0.0), ("right", BASE)):
        frame, place = plant.world_frame(), [x, 0.0, 0.0]
        for name in ("proximal", "distal"):
            body = plant.AddRigidBody(f"{side}_{name}", inertia)
            held = plant.AddFrame(FixedOffsetFrame(f"{side}_{name}_axis", frame, RigidTransform(place)))
            joints.append(plant.AddJoint(RevoluteJoint(f"{side}_{name}", held, body.body_frame(), [0.0, 0.0, 1.0])))
            frame, place = body.body_frame(), [LENGTH, 0.0, 0.0]
        ends.append(body)
    plant.AddBallConstraint(ends[0], place, ends[1], place)
    plant.Finalize()
    return plant, joints


class _Loads(LeafSystem):
    """Servos and friction as generalised forces, constant during a step: Drake's discrete plant accepts no other custom forces."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorInputPort("state", 8)
        self.DeclareVectorOutputPort("torques", 4, self._torques)

    def _torques(self, context, output) -> None:
        p, q, r, s, v, w, x, y = self.get_input_port().Eval(context)
        output.SetFromVector(joint_torques(np.array([p, p + q, r + s, r, v, v + w, x + y, x])))


def _loaded(plant):
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    loads = builder.AddSystem(_Loads())
    builder.Connect(plant.get_state_output_port(), loads.get_input_port())
    builder.Connect(loads.get_output_port(), plant.get_applied_generalized_force_input_port())
    return builder.Build()


def _setting(step: float) -> Setting:
    def begin(start, loaded=False):
        plant, joints = _plant(step)
        system = _loaded(plant) if loaded else plant
        simulator = Simulator(system)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        a, b, c, d = start[:4]
        for joint, angle in zip(joints, (a, b - a, d, c - d)):
            joint.set_angle(context, angle)
        simulator.Initialize()

        def advance(until):
            simulator.AdvanceTo(until)
            p, q, r, s = (joint.get_angle(context) for joint in joints)
            v, w, x, y = (joint.get_angular_rate(context) for joint in joints)
            return np.array([p, p + q, r + s, r, v, v + w, x + y, x])

        return advance

    return Setting(f"discrete, SAP, ball constraint, h = {step:g} s", begin, begin_loaded=partial(begin, loaded=True))
