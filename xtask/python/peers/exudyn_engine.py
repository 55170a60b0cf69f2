"""Exudyn: four planar rigid bodies, five revolute joints, its implicit second-order integrators."""

from functools import partial

import exudyn as exu
import exudyn.itemInterface as item
import numpy as np

from machine import BASE, COM, INERTIA, JOINTS, LENGTH, MASS, G, Peer, Setting, friction_torque, servo_torque

# Spectral radius 1: the trapezoidal rule with index-2 constraints; 0.8: generalised-alpha.
RUNS = tuple(
    (solver, step) for solver in ("TrapezoidalIndex2", "GeneralizedAlpha") for step in (4e-3, 2e-3, 1e-3, 1e-4, 1e-5)
)
# Each link with the link that carries it; -1 is the ground.
LINKS = ((0, -1), (1, 0), (2, 3), (3, -1))


def peer() -> Peer:
    return Peer("Exudyn", exu.__version__, (_setting(*run) for run in RUNS))


def _poses(angles: np.ndarray) -> list[list[float]]:
    """x, y, angle of each link's centre of mass."""
    ends: dict[int, tuple[float, float]] = {}
    poses: list[list[float]] = [[], [], [], []]
    for link in (0, 1, 3, 2):
        carrier = dict(LINKS)[link]
        x, y = (0.0 if link == 0 else BASE, 0.0) if carrier < 0 else ends[carrier]
        c, s = np.cos(angles[link]), np.sin(angles[link])
        poses[link] = [x + COM * c, y + COM * s, angles[link]]
        ends[link] = (x + LENGTH * c, y + LENGTH * s)
    return poses


def _setting(solver: str, step: float) -> Setting:
    def begin(start, loaded=False):
        container = exu.SystemContainer()
        system = container.AddSystem()
        ground = system.AddObject(item.ObjectGround())
        bodies, nodes = [], []
        for pose in _poses(start[:4]):
            nodes.append(system.AddNode(item.NodeRigidBody2D(referenceCoordinates=pose, initialVelocities=[0, 0, 0])))
            bodies.append(
                system.AddObject(item.ObjectRigidBody2D(physicsMass=MASS, physicsInertia=INERTIA, nodeNumber=nodes[-1]))
            )
            centre = system.AddMarker(item.MarkerBodyPosition(bodyNumber=bodies[-1], localPosition=[0, 0, 0]))
            system.AddLoad(item.LoadForceVector(markerNumber=centre, loadVector=[0, -MASS * G, 0]))

        def marker(body, x):
            return system.AddMarker(item.MarkerBodyPosition(bodyNumber=body, localPosition=[x, 0, 0]))

        def joint(first, second):
            system.AddObject(item.ObjectJointRevolute2D(markerNumbers=[first, second]))

        for link, carrier in LINKS:
            held = marker(bodies[carrier], LENGTH - COM) if carrier >= 0 else marker(ground, 0.0 if link == 0 else BASE)
            joint(held, marker(bodies[link], -COM))
        joint(marker(bodies[1], LENGTH - COM), marker(bodies[2], LENGTH - COM))
        if loaded:
            _load(system, nodes, start)
        system.Assemble()
        settings = exu.SimulationSettings()
        settings.timeIntegration.newton.relativeTolerance = 1e-10
        settings.timeIntegration.newton.absoluteTolerance = 1e-12
        settings.timeIntegration.verboseMode = 0
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = 1e9
        now = 0.0

        def advance(until):
            nonlocal now
            settings.timeIntegration.startTime, settings.timeIntegration.endTime = now, until
            settings.timeIntegration.numberOfSteps = max(1, round((until - now) / step))
            kind = getattr(exu.DynamicSolverType, solver)
            if not system.SolveDynamic(
                settings, solverType=kind, updateInitialValues=True, showHints=False, showCausingItems=False
            ):
                raise RuntimeError("the solver failed")
            now = until
            angles = [system.GetNodeOutput(n, exu.OutputVariableType.Coordinates)[2] for n in nodes]
            rates = [system.GetNodeOutput(n, exu.OutputVariableType.Coordinates_t)[2] for n in nodes]
            return np.array([start[i] + angles[i] for i in range(4)] + rates)

        return advance

    return Setting(f"{solver}, h = {step:g} s, Newton 1e-10", begin, begin_loaded=partial(begin, loaded=True))


def _load(system, nodes: list, start: np.ndarray) -> None:
    """Servos and friction: user forces between the angles of two links, or of a link and the ground."""
    ground = system.AddNode(item.NodePointGround())

    def angle(link: int | None):
        node, coordinate = (ground, 0) if link is None else (nodes[link], 2)
        return system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate))

    def between(first: int, second: int | None, force) -> None:
        # Exudyn applies the returned value to the second marker with a negative sign, and passes the second marker's rate.
        markers = [angle(second), angle(first)]
        system.AddObject(
            item.ObjectConnectorCoordinateSpringDamper(markerNumbers=markers, springForceUserFunction=force)
        )

    def friction(_system, _t, _number, _displacement, rate, *_):
        return -friction_torque(rate)

    for first, second in JOINTS:
        between(first, second, friction)
    for motor, link in enumerate((0, 3)):

        def servo(_system, _t, _number, displacement, rate, *_, motor=motor, link=link):
            return -servo_torque(motor, start[link] + displacement, rate)

        between(link, None, servo)
