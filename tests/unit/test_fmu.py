"""FMUs: valid by FMPy, and equal to the model, to the simulator and to equations of motion written plainly."""

import ctypes
import zipfile
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from export_models import EVERY_FUNCTION, MODELS, THROUGH_THE_AIR, model, normalised
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from made_model import TERMS, document

from quasi import attitude
from quasi.errors import ConfigError
from quasi.export import fmu_archive
from quasi.export.agreement import states_of, wrench_of
from quasi.export.compiler import FLAGS, find_compiler, shared_library
from quasi.export.fmu_archive import compile_fmu, platform_folder, write_fmu
from quasi.export.fmu_running import CO_SIMULATION, MODEL_EXCHANGE, Instance, check_forces, check_vehicle, slopes
from quasi.export.fmu_source import DELAYED_COMMANDS, STATE_NAMES, forces_fmu, vehicle_fmu
from quasi.model.commands import extended_map
from quasi.model.model import AXES, Model
from quasi.simulation.loop.python_loop import QuadrotorSimulator
from quasi.simulation.loop.setup import make_setup
from quasi.terms.rotor_map import steady_speeds

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def with_rotors(**more):
    """The made model with unlike rotors, limits and a delay that is no whole number of steps."""
    plain = document()
    plain["actuators"] = {
        "time constants up": {"value": [0.02, 0.025, 0.03, 0.035]},
        "time constants down": {"value": [0.04, 0.045, 0.05, 0.055]},
        "delay": {"value": 0.0065},
    }
    plain["airframe"] |= {"idle RPM": 300.0, "max RPM": 900.0, "motor poles": 14}
    plain["airframe"]["inertia"] = [[9e-4, 2e-5, -1e-5], [2e-5, 1.1e-3, 3e-5], [-1e-5, 3e-5, 1.7e-3]]
    return Model({**plain, **more})


def on_battery():
    """A model that reads the battery's voltage, and whose rotors slow down as it falls."""
    terms = {**EVERY_FUNCTION, "Mz": TERMS["Mz"], "Fy": TERMS["Fy"]}
    extension = {"id": "sag", "actuators": {"voltage exponent": 0.7}, "environment": {"wind": [1.0, -2.0, 0.5]}}
    envelope = {"battery_voltage": {"min": 14.0, "max": 17.0, "percentiles": {"50": 15.5}}}
    return model(terms, "battery", extensions=[extension], envelope=envelope)


@pytest.fixture(scope="module", autouse=True)
def quick_compiler():
    """Libraries without optimisation are compiled three times as fast; two are as users have them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu_archive, "FLAGS", tuple("-O0" if flag == "-O2" else flag for flag in FLAGS))
        yield


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("vehicle")
    made = with_rotors()
    fmu = vehicle_fmu(made)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu_archive, "FLAGS", FLAGS)
        library = write_fmu(folder / "vehicle.fmu", fmu, folder)
    return made, fmu, library, folder / "vehicle.fmu"


@pytest.mark.parametrize("make", [*MODELS.values(), normalised, on_battery])
def test_fmus_are_valid_and_give_the_model_s_numbers(make, tmp_path, monkeypatch):
    if make is MODELS["bundled"]:
        monkeypatch.setattr(fmu_archive, "FLAGS", FLAGS)
    made = make()
    for describe, check in ((forces_fmu, check_forces), (vehicle_fmu, check_vehicle)):
        try:
            fmu = describe(made)
        except ConfigError as error:
            assert "v_in" in str(error) and describe is vehicle_fmu
            continue
        path = tmp_path / f"{fmu.identifier}.fmu"
        library = write_fmu(path, fmu, tmp_path)
        assert validate_fmu(str(path)) == []
        for found in check(made, fmu, library):
            assert found.agrees and found.limit == 1e-12, found


def test_fmpy_simulates_the_force_and_moment_model(tmp_path):
    made = MODELS["bundled"]()
    fmu = forces_fmu(made)
    write_fmu(tmp_path / "forces.fmu", fmu, tmp_path)
    at, dt = states_of(made, 101), 0.01
    names = [v.name for v in fmu.variables if v.causality == "input"]
    columns = [at.table[:, made.inputs.index(name)] for name in names]
    signals = np.array(list(zip(np.arange(101) * dt, *columns)), dtype=[(n, float) for n in ("time", *names)])
    reference = wrench_of(made, at)
    result = fmpy.simulate_fmu(
        str(tmp_path / "forces.fmu"), stop_time=1.0, step_size=dt, output_interval=dt, input=signals, output=list(AXES),
        fmi_type="CoSimulation",
    )  # fmt: skip
    found = np.column_stack([result[axis] for axis in AXES])
    # the row of an instant holds what the inputs of the step before it gave
    np.testing.assert_allclose(found[1:], reference[:-1], rtol=1e-9, atol=1e-9 * np.abs(reference).max(axis=0).min())


def flown_by_the_simulator(made, commands, dt, wind=(0.0, 0.0, 0.0), **sections):
    """States (N + 1, 17) of the simulator in Python whose controller gives these commands."""
    settings = {
        "model": {"model ID": made.id, "correct for moment asymmetries": False},
        "simulation": {"time step": dt, "duration": len(commands) * dt},
        "noise": {"add": False},
        "wind": {"steady": list(wind)},
        **sections,
    }
    simulator = QuadrotorSimulator(make_setup(settings, made))
    simulator.steps["controller"] = lambda bus: commands[min(bus.step, len(commands) - 1)]
    return simulator.run().state[: len(commands) + 1].copy()


def test_vehicle_flies_as_the_simulator_does(vehicle):
    made, fmu, _, path = vehicle
    dt, steps, wind = 0.002, 500, (2.0, -1.0, 0.5)
    random = np.random.default_rng(4)
    hover = made.hover_speed
    commands = hover + np.repeat(random.normal(0.0, 60.0, (steps // 10, 4)), 10, axis=0)
    commands[200:210] = 3000.0  # beyond the limit
    expected = flown_by_the_simulator(made, commands, dt, wind)
    description = fmpy.read_model_description(str(path))
    at = {v.name: v.valueReference for v in description.modelVariables}
    instance = FMU2Slave(
        guid=description.guid, unzipDirectory=fmpy.extract(str(path), path.parent / "unzipped"),
        modelIdentifier=description.coSimulation.modelIdentifier, instanceName="vehicle",
    )  # fmt: skip
    instance.instantiate()
    instance.setupExperiment(startTime=0.0)
    instance.enterInitializationMode()
    instance.setReal([at[n] for n in STATE_NAMES], expected[0])
    instance.exitInitializationMode()
    inputs = [at[n] for n in ("w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD", "wind_north", "wind_east", "wind_down")]
    states = [at[n] for n in STATE_NAMES]
    found, kept, blob = [expected[0]], None, None
    for k in range(steps):
        if k == 250:
            kept = instance.getFMUstate()
            blob = instance.serializeFMUstate(kept)
        instance.setReal(inputs, [*commands[k], *wind])
        instance.doStep(k * dt, dt)
        found.append(np.array(instance.getReal(states)))
    found = np.array(found)
    assert np.abs(expected[-1, 4:7]).max() > 1.0 and np.abs(expected[:, 7:10]).max() > 0.5
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-12, rtol=0.0)
    # back to a kept state, which also went through bytes, and on as before
    for restored in (kept, instance.deSerializeFMUstate(blob)):
        instance.setFMUstate(restored)
        for k in range(250, 300):
            instance.setReal(inputs, [*commands[k], *wind])
            instance.doStep(k * dt, dt)
        np.testing.assert_array_equal(instance.getReal(states), found[300])
        instance.freeFMUstate(restored)
    instance.terminate()
    instance.freeInstance()


def test_velocity_through_the_air_is_one_under_both_names(tmp_path):
    plain = {axis: {e.replace("_air", ""): 0.0 for e in terms} for axis, terms in THROUGH_THE_AIR.items()}
    for axis, terms in THROUGH_THE_AIR.items():
        for expression, coefficient in terms.items():
            plain[axis][expression.replace("_air", "")] += coefficient
    made, wind = MODELS["air"](), (2.0, -1.0, 0.5)
    commands = np.tile(made.hover_speed * np.array([1.05, 1.0, 1.02, 1.1]), (100, 1))
    expected = flown_by_the_simulator(model(plain, "plain"), commands, 0.002, wind)
    np.testing.assert_allclose(flown_by_the_simulator(made, commands, 0.002, wind), expected, rtol=1e-11, atol=1e-13)
    assert np.abs(flown_by_the_simulator(made, commands, 0.002) - expected).max() > 0.01
    fmu = vehicle_fmu(made)
    library = compile_fmu(fmu, tmp_path)
    with Instance(fmu, library, CO_SIMULATION, dict(zip(STATE_NAMES, expected[0]))) as instance:
        for k, command in enumerate(commands):
            instance.set(["w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD", "wind_north", "wind_east", "wind_down"],
                         [*command, *wind])  # fmt: skip
            instance.step(k * 0.002, 0.002)
        np.testing.assert_allclose(instance.get(STATE_NAMES), expected[-1], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("reads", [True, False])
def test_battery_slows_the_rotors_as_in_the_simulator(reads, tmp_path):
    made = on_battery()
    if not reads:
        made = model(TERMS, "plain", extensions=[{"id": "sag", "actuators": {"voltage exponent": 0.7}}])
    fmu = vehicle_fmu(made)
    start = {v.name: v.start for v in fmu.variables}
    assert (start["battery_voltage"], start["voltage_exponent"]) == ((15.5, 0.7) if reads else (1.0, 0.7))
    assert start["wind_east"] == (-2.0 if reads else 0.0)
    battery = {"voltage": 14.6, "reference voltage": 15.5, "exponent": 0.7}
    commands = np.tile(made.hover_speed * np.array([1.05, 1.0, 1.02, 1.1]), (100, 1))
    expected = flown_by_the_simulator(made, commands, 0.002, battery=battery)
    given = {"reference_voltage": 15.5, "battery_voltage": 14.6, **dict(zip(STATE_NAMES, expected[0]))}
    with Instance(fmu, compile_fmu(fmu, tmp_path), CO_SIMULATION, given) as instance:
        for k, command in enumerate(commands):
            instance.set(["w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD"], command)
            instance.step(k * 0.002, 0.002)
        found = instance.get(STATE_NAMES)
    assert found[13] < 0.99 * commands[0, 0]
    np.testing.assert_allclose(found, expected[-1], rtol=1e-11, atol=1e-11)


DRIVE = {
    "source": "commands", "input": "share", "form": "quadratic",
    "parameters": {"slope": {"value": 0.7}, "curvature": {"value": 0.1}}, "operating command": 0.47,
    "reference voltage": 15.1, "voltage exponent": {"value": 0.83}, "speeds": {"value": [90.0, 87.0, 91.5, 90.5]},
    "time constant": {"value": 0.034}, "delay": {"value": 0.0065},
}  # fmt: skip


def test_commands_and_volts_fly_the_vehicle_as_their_speeds_do(tmp_path):
    """By the model's map, with a delay of no whole number of steps; an extension's exponent counts once."""
    made = with_rotors(**{"rotor speeds": DRIVE, "extensions": [{"id": "sag", "actuators": {"voltage exponent": 0.9}}]})
    fmu = vehicle_fmu(made)
    library = write_fmu(tmp_path / "vehicle.fmu", fmu, tmp_path)
    checks = check_vehicle(made, fmu, library)
    assert all(check.agrees for check in checks)
    assert "FMU, derivatives by commands and volts" in {check.what for check in checks}
    random = np.random.default_rng(3)
    commands, volts = 0.47 * random.uniform(0.9, 1.1, (40, 4)), np.linspace(15.5, 14.5, 40)
    speeds = steady_speeds(extended_map(made.document), commands, volts)
    flown = []
    for names, rows, start in (
        ([f"w{i}_CMD" for i in range(1, 5)], speeds, {"voltage_exponent": 0.0}),
        ([f"command{i}" for i in range(1, 5)], commands, {"takes_commands": 1.0}),
    ):
        with Instance(fmu, library, CO_SIMULATION, start) as instance:
            for k, row in enumerate(rows):
                instance.set([*names, "battery_voltage"], [*row, volts[k]])
                instance.step(k * 0.004, 0.004)
            flown.append(instance.get(STATE_NAMES))
    np.testing.assert_allclose(flown[1], flown[0], rtol=1e-9, atol=1e-12)


def test_a_vehicle_without_a_map_takes_speeds_alone(vehicle):
    assert not {"takes_commands", "command1"} & {v.name for v in vehicle[1].variables}


def test_vehicle_by_model_exchange_agrees_with_co_simulation(vehicle):
    _, fmu, _, path = vehicle
    at = {v.name: v.start for v in fmu.variables}
    speed, names = at["w1_CMD"], ["x", "y", "z", "w", "p", "w1", "qw", "ax"]
    times = np.array([0.0, 0.05, 0.05, 0.3])
    step = np.array([0.0, 0.0, 30.0, 30.0])
    signals = np.array(
        [(t, speed + s, speed + s, speed + s, speed) for t, s in zip(times, step)],
        dtype=[(n, float) for n in ("time", "w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD")],
    )
    common = {"stop_time": 0.3, "output_interval": 0.005, "input": signals, "output": names}
    exchanged = fmpy.simulate_fmu(
        str(path), fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-9, **common
    )
    stepped = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", **common)
    assert abs(stepped["p"][-1]) > 0.01
    for name in names:
        pairs = np.interp(stepped["time"], exchanged["time"], exchanged[name])
        np.testing.assert_allclose(pairs, stepped[name], atol=2e-4 * max(1.0, np.abs(pairs).max()))


def test_communication_steps_of_any_length_give_the_same_flight(vehicle):
    _, fmu, library, _ = vehicle
    speed = next(v.start for v in fmu.variables if v.name == "w1_CMD")
    found = []
    for dt in (0.002, 0.01, 0.05):
        with Instance(fmu, library, CO_SIMULATION) as instance:
            instance.set(["w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD"], [speed + 20, speed - 20, speed, speed + 5])
            for k in range(round(0.2 / dt)):
                instance.step(k * dt, dt)
            found.append(instance.get(STATE_NAMES))
    assert np.abs(found[0][7:10]).max() > 0.1
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=1e-9, atol=1e-12)


def test_planted_sign_errors_are_found(vehicle, tmp_path):
    made, fmu, *_ = vehicle
    for number, (old, new) in enumerate(
        (
            ("state[4] = vy - (ay", "state[4] = vy + (ay"),
            ("mx = loads[3] - (q*hz - r*hy)", "mx = loads[3] + (q*hz - r*hy)"),
            ("slope[6] = loads[2]/mass - (p*vy", "slope[6] = loads[2]/mass + (p*vy"),
            ("hx = i[0]*p + i[3]*q", "hx = i[0]*p - i[3]*q"),
        )
    ):
        source = fmu.files["sources/vehicle.c"]
        assert old in source
        wrong = fmu._replace(files={**fmu.files, "sources/vehicle.c": source.replace(old, new)})
        (tmp_path / str(number)).mkdir()
        library = compile_fmu(wrong, tmp_path / str(number))
        assert not all(check.agrees for check in check_vehicle(made, wrong, library))
    forces = forces_fmu(made)
    source = forces.files["sources/quasi_m.c"].replace("Mx += N(1e-07)*U_p", "Mx -= N(1e-07)*U_p")
    wrong = forces._replace(files={**forces.files, "sources/quasi_m.c": source})
    (check,) = check_forces(made, wrong, compile_fmu(wrong, tmp_path))
    assert not check.agrees and check.where == "Mx"


def test_plain_equations_keep_energy_and_angular_momentum_in_empty_space():
    bare = model({axis: {"u": 0.0} for axis in AXES})
    x = np.array([[1.0, 0.0, 0.0, 0.0, 3.0, -2.0, 1.0, 2.0, -1.0, 0.5, 0.0, 0.0, 0.0, *[900.0] * 4]])
    rate = slopes(bare, x, x[:, 13:], np.zeros((1, 3)))[0]
    inertia, omega = bare.airframe.inertia, x[0, 7:10]
    assert omega @ inertia @ rate[7:10] == pytest.approx(0.0, abs=1e-15)  # rotational energy
    np.testing.assert_allclose(inertia @ rate[7:10] + np.cross(omega, inertia @ omega), 0.0, atol=1e-15)
    np.testing.assert_allclose(rate[4:7] + np.cross(omega, x[0, 4:7]), [0.0, 0.0, 9.81], atol=1e-14)
    np.testing.assert_array_equal(rate[10:13], x[0, 4:7])


def test_vehicle_outputs_specific_force_and_attitude(vehicle):
    made, fmu, library, _ = vehicle
    net = Model({**made.document, "gravity": "noGravity"})
    with Instance(fmu, library, CO_SIMULATION) as instance:
        loads, felt = instance.get(AXES[:3]), instance.get(["ax", "ay", "az"])
        np.testing.assert_allclose(felt, loads / made.airframe.mass, rtol=1e-12)
    q = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])
    other = vehicle_fmu(net)
    folder = library.parent / "net"
    folder.mkdir()
    with Instance(other, compile_fmu(other, folder), CO_SIMULATION, dict(zip(("qw", "qx", "qy", "qz"), q))) as instance:
        down = attitude.rotate_inverse(q, np.array([0.0, 0.0, 9.81]))
        loads, felt = instance.get(AXES[:3]), instance.get(["ax", "ay", "az"])
        np.testing.assert_allclose(felt, loads / net.airframe.mass - down, rtol=1e-12)
        np.testing.assert_allclose(instance.get(["roll", "pitch", "yaw"]), attitude.to_euler(q), rtol=1e-12)


def test_outputs_during_initialisation_are_those_of_its_end(vehicle):
    _, fmu, _, path = vehicle
    at = {v.name: v.at for v in fmu.variables}
    start = {
        "qw": 1.8, "qx": 0.2, "qy": -0.4, "qz": 0.6, "u": 3.0, "p": 2.0, "q": -1.0, "r": 0.5, "w1": 800.0,
        "w1_CMD": 1200.0, "wind_east": 2.0, "mass": 0.5, "inertia_xx": 2e-3, "inertia_xz": 1e-4,
    }  # fmt: skip
    given = [at[n] for n in start]
    asked = [v.at for v in fmu.variables if v.start is None]  # derivatives, angles, forces, specific force
    instance = FMU2Slave(
        guid=fmu.guid, unzipDirectory=fmpy.extract(str(path), path.parent / "asked"),
        modelIdentifier=fmu.identifier, instanceName="vehicle",
    )  # fmt: skip
    instance.instantiate()
    instance.setupExperiment(startTime=5.0)
    instance.enterInitializationMode()
    for name, value in start.items():  # asking in between moves nothing
        instance.getReal(asked)
        instance.setReal([at[name]], [value])
    before = instance.getReal(asked)
    assert instance.getReal(given) == list(start.values())
    instance.exitInitializationMode()
    np.testing.assert_array_equal(before, instance.getReal(asked))
    found = dict(zip((v.name for v in fmu.variables if v.start is None), before))
    assert abs(found["der(p)"]) > 0.1 and found["der(w1)"] == 0.0  # the command comes late
    instance.freeInstance()


@pytest.mark.parametrize(
    "start",
    [{"mass": 0.0}, {"inertia_zz": -1.0}, {"inertia_xy": 1.0}, {"delay": -0.1}, {"time_constant_up_3": 0.0},
     {"lowest_speed": 1e6}, {"longest_step": 0.0}, {"qw": 0.0}, {"mass": float("nan")}],
)  # fmt: skip
def test_impossible_parameters_are_refused(vehicle, start):
    _, fmu, library, _ = vehicle
    with pytest.raises(ValueError, match="fmi2ExitInitializationMode"):
        Instance(fmu, library, CO_SIMULATION, start)


def test_an_impossible_battery_is_refused(tmp_path):
    fmu, nan, infinite = vehicle_fmu(on_battery()), float("nan"), float("inf")
    library = compile_fmu(fmu, tmp_path)
    for name, values in {
        "reference_voltage": [0.0, -15.5, nan, infinite],
        "voltage_exponent": [nan, infinite, -infinite],
    }.items():
        for value in values:
            with pytest.raises(ValueError, match="fmi2ExitInitializationMode"):
                Instance(fmu, library, CO_SIMULATION, {name: value})
    with Instance(fmu, library, CO_SIMULATION, {"reference_voltage": 0.1, "voltage_exponent": 0.0}) as instance:
        instance.step(0.0, 0.002)


def test_what_cannot_be_set_or_asked_is_refused(vehicle):
    _, fmu, library, _ = vehicle
    with Instance(fmu, library, CO_SIMULATION) as instance:
        with pytest.raises(ValueError, match="fmi2SetReal"):
            instance.set(["Fx"], [1.0])
        for name in ("inertia_xx", "mass", "qw", "w1"):  # their values were taken up when initialisation ended
            with pytest.raises(ValueError, match="fmi2SetReal"):
                instance.set([name], [1.0])
        instance.set(["w1_CMD", "wind_down"], [1.0, 1.0])
        with pytest.raises(ValueError, match="fmi2DoStep"):
            instance.step(0.0, -1.0)
    with pytest.raises(ValueError, match="cannot be instantiated"):
        Instance(fmu._replace(guid="{0}"), library, CO_SIMULATION)


def test_commands_that_cannot_be_remembered_end_a_flight(vehicle):
    _, fmu, library, _ = vehicle
    with Instance(fmu, library, MODEL_EXCHANGE) as instance:
        flags = ctypes.byref(ctypes.c_int()), ctypes.byref(ctypes.c_int())
        with pytest.raises(ValueError, match="fmi2CompletedIntegratorStep"):
            for k in range(5000):
                instance._call("fmi2SetTime", ctypes.c_double(k * 1e-6))
                instance._call("fmi2CompletedIntegratorStep", 1, *flags)
        assert k == DELAYED_COMMANDS - 1


def test_sources_inside_are_complete_and_compile_without_a_warning(vehicle, tmp_path):
    _, fmu, _, path = vehicle
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        archive.extractall(tmp_path)
    assert f"binaries/{platform_folder()}/{fmu.identifier}.so" in names
    root = ElementTree.parse(tmp_path / "modelDescription.xml").getroot()
    files = [f.get("name") for f in root.iter("File")]
    assert sorted(set(files)) == sorted(fmu.units) and len(files) == 2 * len(fmu.units)
    strict = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared")
    prefix = f"FMI2_FUNCTION_PREFIX={fmu.identifier}_"
    library = shared_library(tmp_path / "sources", sorted(set(files)), "static.so", [prefix], strict)
    assert hasattr(ctypes.CDLL(str(library)), f"{fmu.identifier}_fmi2DoStep")


def test_the_same_model_gives_the_same_archive(vehicle, tmp_path):
    made, fmu, _, path = vehicle
    again = vehicle_fmu(made)
    assert again.guid == fmu.guid
    write_fmu(tmp_path / "again.fmu", again, tmp_path)
    with zipfile.ZipFile(path) as one, zipfile.ZipFile(tmp_path / "again.fmu") as other:
        assert one.namelist() == other.namelist()
        for name in one.namelist():
            if not name.startswith("binaries"):
                assert one.read(name) == other.read(name)
    changed = Model({**made.document, "hover speed": {"value": made.hover_speed + 1.0}})
    assert vehicle_fmu(changed).guid != fmu.guid
