"""Effects through FMPy: action of each effect, tunable parameters, refusals and log messages."""

import math
from collections.abc import Callable

import pytest
from fmpy import fmi2

from instance import Instance, Values

New = Callable[..., Instance]

FLAT = {"gravity.enabled": False, "base.distance": 0.1, "init.theta[1]": 2.2209, "init.theta[2]": 0.9207}
TURNING = FLAT | {"init.omega[1]": 3.0, "init.omega[2]": -2.0}
EFFECTS = ("rotor", "payload", "gravity", "viscous", "friction", "spring", "stop", "contact", "servo")


def with_and_without(new: New, effect: str, values: Values) -> tuple[Instance, Instance]:
    """Two instances ready to step, one with the effect and one without."""
    return tuple(new().initialise(values | {f"{effect}.enabled": on}) for on in (True, False))


@pytest.mark.parametrize("effect", EFFECTS)
def test_ready_names_the_active_effects_and_no_others(new: New, effect: str) -> None:
    instance = new(logging_on=True)
    instance.initialise(FLAT | {f"{effect}.enabled": True})
    (ready,) = [m.text for m in instance.log.messages if m.text.startswith("ready")]
    assert ready.endswith(f"effects: {effect}")


def test_every_effect_has_a_switch_that_is_named_here(model: object) -> None:
    switches = {v.name.removesuffix(".enabled") for v in model.modelVariables if v.name.endswith(".enabled")}
    assert switches == set(EFFECTS) | {"estimator", "estimator.learn"}


def test_masses_add_their_kinetic_energy(new: New) -> None:
    """m v²/2 of the tip, and n² J ω²/2 of each rotor; 1e-12 is round-off."""
    loaded, bare = with_and_without(new, "payload", TURNING)
    speed = math.hypot(bare.get("tip.vx"), bare.get("tip.vy"))
    assert loaded.get("energy.kinetic") - bare.get("energy.kinetic") == pytest.approx(0.5 * 0.05 * speed**2, rel=1e-12)
    geared, bare = with_and_without(new, "rotor", TURNING | {"rotor.gearRatio[1]": 10.0})
    assert geared.get("energy.kinetic") - bare.get("energy.kinetic") == pytest.approx(
        0.5 * 1e-5 * (100 * 3.0**2 + 2.0**2), rel=1e-12
    )


def test_spring_stores_energy_and_pulls_back(new: New) -> None:
    sprung, bare = with_and_without(new, "spring", FLAT)
    stretch = (2.2209 - math.pi / 2, 0.9207 - math.pi / 2)
    stored = 0.5 * 0.05 * sum(x**2 for x in stretch)
    assert sprung.get("energy.potential") - bare.get("energy.potential") == pytest.approx(stored, rel=1e-12)
    for instance in (sprung, bare):
        instance.steps(50, 1e-3)
    # At rest without the springs, up to round-off.
    assert (bare.get("theta[1]"), bare.get("theta[2]")) == pytest.approx((2.2209, 0.9207), abs=1e-12)
    assert sprung.get("theta[1]") < 2.22 and sprung.get("theta[2]") > 0.921


def test_viscous_friction_dissipates_its_power(new: New) -> None:
    """Sum of b w² over the five joints; during 1 ms the rates change by a relative 1e-3."""
    damped, bare = with_and_without(new, "viscous", TURNING)
    left, right = damped.get("passive.omega[1]"), damped.get("passive.omega[2]")
    rates = (3.0, left - 3.0, left - right, right - -2.0, -2.0)
    for instance in (damped, bare):
        instance.steps(1, 1e-3)
    assert damped.get("energy.dissipated") == pytest.approx(1e-4 * sum(w**2 for w in rates) * 1e-3, rel=1e-2)
    assert bare.get("energy.dissipated") == 0.0


def test_dry_friction_resists_a_small_torque(new: New) -> None:
    """Under half of the Coulomb torque the smooth law creeps at w_c/2 = 5e-3 rad/s or less for 0.5 s; without friction the link accelerates away."""
    sticking, bare = with_and_without(new, "friction", FLAT | {"tau[1]": 5e-4})
    for instance in (sticking, bare):
        instance.steps(500, 1e-3)
    assert abs(sticking.get("theta[1]") - 2.2209) < 2.5e-3 and 0.04 < abs(bare.get("theta[1]") - 2.2209)


def test_stop_ends_a_swing(new: New) -> None:
    """A swing at 3 rad/s, driven by 0.01 N.m, enters a stop of 50 N.m/rad by less than 0.1 rad; without the stop it goes further."""
    values = TURNING | {"stop.upper[1]": 2.4, "tau[1]": 0.01}
    stopped, bare = with_and_without(new, "stop", values)
    furthest = {}
    for instance in (stopped, bare):
        angles = []
        for i in range(300):
            instance.steps(1, 1e-3, i * 1e-3)
            angles.append(instance.get("theta[1]"))
        furthest[instance is stopped] = max(angles)
    assert 2.4 < furthest[True] < 2.5 < furthest[False]


def test_contact_carries_a_pressed_tip(new: New) -> None:
    """A tip pressed with 2 N on a wall of 2e3 N/m rests 1 mm deep with a reaction of 2 N, after it has bounced for less than 1 s."""
    touching, bare = with_and_without(
        new, "contact", FLAT | {"contact.offset": 0.28, "tip.fy": -2.0, "viscous.enabled": True}
    )
    for instance in (touching, bare):
        instance.steps(1000, 1e-3)
    assert touching.get("contact.fy") == pytest.approx(2.0, rel=1e-3)
    assert touching.get("tip.y") == pytest.approx(0.28 - 1e-3, abs=1e-5)
    assert bare.get("contact.fy") == 0.0 and bare.get("tip.y") < 0.2


def test_servo_goes_to_its_reference(new: New) -> None:
    """PD control without friction or gravity ends at the setpoint; the torque output is the servo's torque."""
    references = {"servo.theta[1]": 2.0, "servo.theta[2]": 1.0}
    driven, bare = with_and_without(new, "servo", FLAT | references)
    assert driven.get("servo.torque[1]") == pytest.approx(math.tanh(2.0 * (2.0 - 2.2209)), rel=1e-12)
    for instance in (driven, bare):
        instance.steps(1000, 1e-3)
    assert (driven.get("theta[1]"), driven.get("theta[2]")) == pytest.approx((2.0, 1.0), abs=1e-3)
    assert bare.get("theta[1]") == pytest.approx(2.2209, abs=1e-12) and bare.get("servo.torque[1]") == 0.0


def test_a_servo_acts_after_its_delay(new: New) -> None:
    """A reference set at 10 ms acts at 27.3 ms, within a step, like a reference set at 27.3 ms. The difference is round-off of the divided step."""
    held = FLAT | {"servo.enabled": True, "servo.theta[1]": 2.2209, "servo.theta[2]": 0.9207}
    late, at_once = (new().initialise(held | {"servo.delay": delay}) for delay in (0.0173, 0.0))
    late.steps(10, 1e-3)
    at_once.steps(27, 1e-3)
    at_once.steps(1, 3e-4, 0.027)
    torque = late.get("servo.torque[1]")
    for instance in (late, at_once):
        instance.set({"servo.theta[1]": 2.3})
    assert late.get("servo.torque[1]") == torque == pytest.approx(0.0, abs=1e-9)
    assert at_once.get("servo.torque[1]") > 0.1
    late.steps(40, 1e-3, 0.01)
    at_once.steps(1, 7e-4, 0.0273)
    at_once.steps(22, 1e-3, 0.028)
    assert late.get("theta[1]") == pytest.approx(at_once.get("theta[1]"), abs=1e-12) and late.get("theta[1]") > 2.225


@pytest.mark.parametrize(("delay", "allowed"), [(-1e-3, "at least 0 s"), (0.11, "at most 0.1 s")])
def test_a_delay_out_of_bounds_is_refused_by_name(new: New, delay: float, allowed: str) -> None:
    instance = new()
    status, text = instance.refusal(instance.set, {"servo.delay": delay})
    assert status == fmi2.fmi2Error and f"servo.delay = {delay}" in text and allowed in text


def test_a_tunable_parameter_acts_from_the_next_step(new: New) -> None:
    """Energy added by a stiffer spring counts as input, so that the balance holds."""
    tuned, left = (new().initialise(FLAT | {"spring.enabled": True}) for _ in range(2))
    for instance in (tuned, left):
        instance.steps(100, 1e-3)
    before = tuned.bits()
    tuned.set({"spring.k[1]": 0.2})
    assert tuned.get("spring.k[1]") == 0.2 and tuned.bits() == before
    stretch, work = tuned.get("theta[1]") - math.pi / 2, tuned.get("energy.input")
    for instance in (tuned, left):
        instance.steps(1, 1e-3, 0.1)
    assert tuned.get("omega[1]") < left.get("omega[1]")
    assert tuned.get("energy.input") - work == pytest.approx(0.5 * (0.2 - 0.05) * stretch**2, rel=1e-9)
    # The method's own error over 0.1 s.
    assert abs(tuned.get("energy.error")) < 1e-8


@pytest.mark.parametrize(
    ("name", "value"), [("payload.enabled", True), ("spring.enabled", False), ("rotor.inertia[1]", 1e-4)]
)
def test_a_fixed_parameter_is_refused_during_the_run(new: New, name: str, value: float | bool) -> None:
    instance = new().initialise(FLAT | {"spring.enabled": True})
    before = instance.bits()
    status, text = instance.refusal(instance.set, {name: value})
    assert status == fmi2.fmi2Error
    assert f"{name} is a fixed parameter and can only be set before fmi2ExitInitializationMode." in text
    assert instance.bits() == before
    instance.steps(1, 1e-3)


def test_a_tuned_value_that_makes_no_sense_is_refused_by_the_step_and_can_be_mended(new: New) -> None:
    instance = new().initialise(TURNING | {"friction.enabled": True})
    instance.set({"friction.breakaway[3]": 5e-4})
    status, text = instance.refusal(instance.slave.doStep, 0.0, 1e-3)
    assert status == fmi2.fmi2Error and "friction.breakaway[3] = 0.0005 N.m" in text
    instance.set({"friction.breakaway[3]": 2e-3})
    instance.steps(1, 1e-3)
    assert instance.get("solver.steps") == 1


def test_a_reference_that_nobody_reads_is_warned_of_once(new: New) -> None:
    deaf, servo = (new().initialise(FLAT | {"servo.enabled": on}) for on in (False, True))
    for instance in (deaf, servo):
        instance.steps(2, 1e-3)
        instance.set({"servo.theta[1]": 1.0})
        instance.steps(5, 1e-3, 2e-3)
        instance.set({"servo.omega[2]": 1.0})
        instance.steps(5, 1e-3, 7e-3)
    (warning,) = deaf.log.warnings()
    assert "servo.theta" in warning and "servo.enabled is false" in warning
    assert servo.log.warnings() == []


@pytest.mark.parametrize(
    ("effect", "values", "sentence"),
    [
        (
            "friction",
            {"friction.breakaway[2]": 5e-4},
            "friction.breakaway[2] = 0.0005 N.m is not allowed: it must be at least",
        ),
        ("stop", {"stop.lower[2]": 4.0}, "stop.lower[2] = 4 rad is not allowed: it must be below stop.upper[2]"),
        ("contact", {"contact.ny": 0.0}, "contact.nx = 0 and contact.ny = 0 are not allowed together"),
    ],
)
def test_relations_are_refused_by_name_if_the_effect_is_on(
    new: New, effect: str, values: Values, sentence: str
) -> None:
    instance = new()
    instance.set(FLAT | values | {f"{effect}.enabled": True})
    instance.enter()
    status, text = instance.refusal(instance.slave.exitInitializationMode)
    assert status == fmi2.fmi2Error and sentence in text
    # Parameters of a disabled effect are not checked.
    new().initialise(FLAT | values)


@pytest.mark.parametrize(
    "name",
    [
        "viscous.b[1]",
        "friction.coulomb[5]",
        "spring.k[1]",
        "stop.d",
        "contact.d",
        "contact.mu",
        "servo.kd[2]",
        "payload.mass",
    ],
)
def test_negative_magnitudes_are_refused_by_name(new: New, name: str) -> None:
    instance = new()
    status, text = instance.refusal(instance.set, {name: -1e-3})
    assert status == fmi2.fmi2Error and f"{name} = -0.001" in text and "at least 0" in text
