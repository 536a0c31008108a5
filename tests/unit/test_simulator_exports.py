"""Exports to simulators: signs and numbers by derivations of their own, files read by foreign parsers."""

import json
import os
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import plain_plant
import pytest

from quasi.attitude import GRAVITY
from quasi.command import main
from quasi.errors import DataError
from quasi.export import registry
from quasi.export.frames import swap_inertia, swap_vector
from quasi.export.physical_constants import constants_plain, facts, physical_constants
from quasi.export.registry import SIMULATORS, export_to_simulator
from quasi.export.rotor_links import join_rotors, split_rotors
from quasi.export.targets import SIMULATOR_NAMES, crazyflow, gazebo, px4
from quasi.model.hover import find_hover_speed
from quasi.model.model import Model
from quasi.tables import write_json

ROOT = Path(__file__).parents[2]
HOVER, MASS, ARM = 1500.0, 0.43, 0.0544
THRUST = MASS * GRAVITY / (4.0 * HOVER**2)


def changed(model, **airframe):
    return Model({**model.document, "airframe": {**model.document["airframe"], **airframe}})


def with_axis(model, axis, **terms):
    """The model with coefficients of an axis replaced, or terms added."""
    part = model.document["axes"][axis]
    kept = [t for t in part["terms"] if t["expression"] not in terms]
    new = [{"name": e, "expression": e, "coefficient": c, "std": 0.0, "unit": ""} for e, c in terms.items()]
    rows = [*kept, *new]
    covariance = np.zeros((len(rows), len(rows))).tolist()
    axes = {**model.document["axes"], axis: {**part, "terms": rows, "covariance": covariance}}
    return Model({**model.document, "axes": axes})


def without_axis(model, axis):
    return Model({**model.document, "axes": {a: p for a, p in model.document["axes"].items() if a != axis}})


@pytest.fixture(scope="module")
def model():
    made = plain_plant.made_model()
    constants = {"time constants up": {"value": [0.02, 0.021, 0.022, 0.023], "std": [1e-3] * 4},
                 "time constants down": {"value": [0.04, 0.041, 0.042, 0.043]}, "delay": {"value": [0.004] * 4},
                 "command map": {"coefficients": [300.0, 2100.0, 100.0]}}  # fmt: skip
    hubs = (np.array(made.document["airframe"]["hubs"]) + [0.0, 0.0, -0.012]).tolist()
    return changed(Model({**made.document, "actuators": constants}), hubs=hubs)


@pytest.fixture(scope="module")
def physical(model):
    return physical_constants(model)


# ---- the constants ----


def test_constants_are_those_of_the_terms_that_the_model_was_made_with(physical):
    assert physical.hover == pytest.approx(HOVER, rel=1e-9)
    assert physical.thrust.value == pytest.approx(THRUST, rel=1e-9)
    assert physical.thrust_slope.value == pytest.approx(1.0, rel=1e-6)
    assert physical.torque.value == pytest.approx(0.012 * THRUST, rel=1e-6)
    assert physical.moment_ratio == pytest.approx(0.012, rel=1e-6)
    assert [d.value for d in physical.drag] == pytest.approx([0.12, 0.12, 0.15], rel=1e-9)
    assert [d.value for d in physical.damping] == pytest.approx([8e-4, 8e-4, 5e-4], rel=1e-9)
    assert [m.value for m in physical.pitching] == pytest.approx(
        [2e-3, 2e-3]
    ) and physical.rolling.value == pytest.approx(0.0, abs=1e-12)
    assert physical.rotor_inertia.value == pytest.approx(6e-7, rel=1e-9)
    assert physical.roll.value == pytest.approx(1.0, rel=1e-6) and physical.pitch.value == pytest.approx(1.0, rel=1e-6)
    assert physical.rotor_drag == pytest.approx(0.12 / (4 * HOVER), rel=1e-9)


def test_levers_are_those_of_the_moments_and_not_of_the_drawing(model):
    short = with_axis(model, "Mx", U_p=0.7 * ARM * THRUST)
    found = physical_constants(short)
    assert found.roll.value == pytest.approx(0.7, rel=1e-6) and found.pitch.value == pytest.approx(1.0, rel=1e-6)
    np.testing.assert_allclose(np.abs(found.positions[:, 1]), 0.7 * ARM, rtol=1e-6)


def test_standard_errors_are_those_of_coefficients_drawn_from_their_covariance(model):
    document = json.loads(json.dumps(model.document))
    random = np.random.default_rng(5)
    for part in document["axes"].values():
        size = np.array([abs(t["coefficient"]) or 1e-3 for t in part["terms"]])
        shape = random.standard_normal((len(size), len(size)))
        part["covariance"] = (1e-4 * np.outer(size, size) * (shape @ shape.T)).tolist()
    uncertain = Model(document)
    found = physical_constants(uncertain)

    def read(drawn):
        speeds = np.full((1, 4), found.hover)
        lift = drawn.predict(np.zeros((1, 12)), speeds)[0][0, 2]
        fast, slow = (drawn.predict(np.array([[0, 0, 0, v] + [0] * 8], float), speeds)[0][0, 0] for v in (1.0, -1.0))
        faster, slower = (drawn.predict(np.zeros((4, 12)), found.hover + step * np.eye(4))[1][:, 2] for step in (1, -1))
        by_square = (faster - slower) / (4.0 * found.hover)
        return [-lift / (4 * found.hover**2), 0.5 * (slow - fast), -0.25 * by_square @ drawn.airframe.spin]

    rows = []
    for _ in range(400):
        drawn = json.loads(json.dumps(document))
        for part in drawn["axes"].values():
            moved = random.multivariate_normal([t["coefficient"] for t in part["terms"]], part["covariance"])
            for term, value in zip(part["terms"], moved):
                term["coefficient"] = float(value)
        rows.append(read(Model(drawn)))
    spread = np.std(rows, axis=0)
    # 400 draws give a standard deviation to 3.5 %; five of them
    np.testing.assert_allclose([found.thrust.std, found.drag[0].std, found.torque.std], spread, rtol=0.18)


def test_constants_without_data_have_no_standard_error(model):
    axes = {a: {**p, "n": 0} for a, p in model.document["axes"].items()}
    table = constants_plain(physical_constants(Model({**model.document, "axes": axes})))
    assert table["constants"]["thrust coefficient"]["std"] == [None]
    assert table["constants"]["time constants up"]["std"] == [1e-3] * 4
    json.dumps(table, allow_nan=False)


def test_a_net_force_model_has_the_same_constants(physical):
    found = physical_constants(plain_plant.made_model(gravity="noGravity"))
    assert found.thrust.value == pytest.approx(physical.thrust.value, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda m: changed(m, mass=None), "no mass"),
        (
            lambda m: Model({**m.document, "axes": {a: p for a, p in m.document["axes"].items() if a != "My"}}),
            "axis My",
        ),
        (lambda m: with_axis(m, "Mz", U_r=0.012 * THRUST), "'rotor1 rotation direction'"),
        (lambda m: with_axis(m, "Mx", U_p=-ARM * THRUST), "'rotor config'"),
    ],
)
def test_a_model_that_contradicts_its_geometry_is_refused_with_the_key(model, change, named):
    with pytest.raises(DataError, match=re.escape(named)):
        physical_constants(change(model))


# ---- every target ----


def test_the_registry_and_the_names_of_the_rules_agree():
    assert tuple(SIMULATORS) == SIMULATOR_NAMES


def test_the_docs_hold_the_table_of_targets():
    table = "\n".join(f"| `models/<model>/{one.name}` | {one.title} | {one.needs} |" for one in SIMULATORS.values())
    assert table in (ROOT / "docs/exports.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", SIMULATOR_NAMES)
@pytest.mark.parametrize("kind", ["full", "without limits and map"])
def test_files_read_back_agree_with_the_model(name, kind, model, tmp_path):
    made = model if kind == "full" else changed(plain_plant.made_model(lag=0.03), **{"max RPM": None, "idle RPM": None})
    if kind != "full" and name == "gazebo":
        with pytest.raises(DataError, match="'max RPM'"):
            export_to_simulator(made, name, tmp_path)
        return
    checks, _, files = export_to_simulator(made, name, tmp_path)
    assert all(c.agrees for c in checks), checks
    assert {p.name for p in tmp_path.iterdir()} == set(files)
    if kind == "full":
        assert "moments by rotor speed" in {c.what for c in checks}


@pytest.mark.parametrize(("name", "file", "element"), [
    ("gazebo", "model.sdf", "<motorConstant>"), ("gazebo", "model.sdf", "<timeConstantDown>"),
    ("gazebo", "model.sdf", "<rotorDragCoefficient>"), ("gazebo", "model.sdf", "<ixx>"),
    ("px4", None, "CA_ROTOR0_KM"), ("px4", None, "MPC_THR_HOVER"), ("crazyflow", "params.toml", "rotor_dyn_coef = ["),
    ("crazyflow", "params.toml", "mass = "), ("mjcf", "quadrotor.xml", 'dynprm="'), ("mjcf", "quadrotor.xml", 'act="'),
    ("urdf", "quadrotor.urdf", 'mass value="'),
])  # fmt: skip
def test_one_wrong_number_in_a_file_is_found(name, file, element, model, monkeypatch, tmp_path):
    """Each number is scaled by 1.001 after it was written: the comparison must fail."""
    right = SIMULATORS[name]

    def wrong(physical):
        files = right.write(physical)
        for key in files if file is None else [file]:
            pattern = re.escape(element) + r"\s*(-?[0-9.e-]+)"
            found = re.search(pattern, files[key])
            start, end = found.span(1)
            files[key] = f"{files[key][:start]}{1.001 * float(found[1]):.9g}{files[key][end:]}"
        return files

    monkeypatch.setitem(registry.SIMULATORS, name, right._replace(write=wrong))
    checks, _, _ = export_to_simulator(model, name, tmp_path)
    assert not all(c.agrees for c in checks)


def test_what_a_format_leaves_out_stands_in_its_file(physical):
    urdf = SIMULATORS["urdf"].write(physical)["quadrotor.urdf"]
    assert "thrust coefficient: " in urdf and "time constants down: " in urdf and "delay: 0.004 s" in urdf
    sdf = SIMULATORS["gazebo"].write(physical)["model.sdf"]
    assert "thrust coefficient: " not in sdf and "vertical drag: 0.15 N/(m/s)" in sdf and "pitching moment: " not in sdf
    assert "pitching moment: 0.002 0.002 N m/(m/s)" in urdf
    toml = SIMULATORS["crazyflow"].write(physical)["params.toml"]
    assert "vertical drag: " not in toml and "rate damping: " in toml


# ---- signs ----


def rotation_about_x():
    return np.array([[1.0, 0, 0], [0, np.cos(np.pi), -np.sin(np.pi)], [0, np.sin(np.pi), np.cos(np.pi)]])


def test_axes_of_simulators_are_a_half_turn_about_x():
    turn, vector = rotation_about_x(), np.array([1.0, 2.0, 3.0])
    tensor = np.array([[3.0, 0.1, 0.2], [0.1, 4.0, 0.3], [0.2, 0.3, 5.0]])
    np.testing.assert_allclose(swap_vector(vector), turn @ vector, atol=1e-15)
    np.testing.assert_allclose(swap_inertia(tensor), turn @ tensor @ turn.T, atol=1e-15)


def sdf_moment(text, speeds):
    """Moment (3,), FLU, of rotors at these speeds, by the law of Gazebo's motor model."""
    root = ElementTree.fromstring(text).find("model")
    total = np.zeros(3)
    for plugin in root.findall("plugin"):
        link = next(x for x in root.findall("link") if x.get("name") == plugin.findtext("linkName"))
        at = np.array([float(v) for v in link.findtext("pose").split()[:3]])
        thrust = float(plugin.findtext("motorConstant")) * speeds[int(plugin.findtext("motorNumber"))] ** 2
        direction = {"ccw": 1, "cw": -1}[plugin.findtext("turningDirection")]
        total += np.cross(at, [0, 0, thrust])
        total[2] += -direction * thrust * float(plugin.findtext("momentConstant"))
    return total


@pytest.mark.parametrize("rotor", range(4))
def test_a_faster_rotor_turns_the_gazebo_and_mujoco_vehicles_as_the_model_turns(rotor, model, physical):
    speeds = np.full(4, HOVER)
    speeds[rotor] *= 1.1
    forces, moments = model.predict(np.zeros(12), speeds)
    flu = rotation_about_x() @ moments
    np.testing.assert_allclose(sdf_moment(gazebo.write(physical)["model.sdf"], speeds), flu, rtol=1e-6)
    root = ElementTree.fromstring(SIMULATORS["mjcf"].write(physical)["quadrotor.xml"])
    sites = {s.get("name"): np.array(s.get("pos").split(), float) for s in root.iter("site")}
    total = np.zeros(3)
    for i, actuator in enumerate(a for a in root.iter("general") if a.get("name").startswith("rotor")):
        gear = np.array(actuator.get("gear").split(), float) * THRUST * speeds[i] ** 2
        total += np.cross(sites[actuator.get("site")], gear[:3]) + gear[3:]
    np.testing.assert_allclose(total, flu, rtol=1e-6)


def test_the_crazyflow_table_gives_the_model_s_forces_and_moments(model, physical):
    """The law of drone-models' first-principles model, written here anew, against `Model.predict`."""
    table = tomllib.loads(crazyflow.write(physical)["params.toml"])["made"]
    random = np.random.default_rng(2)
    for _ in range(5):
        speeds, velocity = HOVER * random.uniform(0.8, 1.2, 4), random.uniform(-1, 1, 3)
        slopes = random.uniform(-2e3, 2e3, 4)
        rpm = speeds * 60.0 / (2.0 * np.pi)
        thrust, torque = (sum(c * rpm**k for k, c in enumerate(table[n])) for n in ("rpm2thrust", "rpm2torque"))
        mixing = np.array(table["mixing_matrix"])
        force = np.array([0, 0, thrust.sum()]) + np.array(table["drag_matrix"]) @ velocity
        moment = np.array([*(table["L"] * mixing[:2] @ thrust), mixing[2] @ (torque + table["prop_inertia"] * slopes)])
        flu = rotation_about_x()
        state = np.concatenate([np.zeros(3), flu @ velocity, np.zeros(6)])
        expected = model.predict(state, speeds, slopes)
        np.testing.assert_allclose(flu @ force, expected[0], rtol=1e-6, atol=1e-9)
        # moments by velocity are named in the file as left out
        without = expected[1] - [-2e-3 * state[4], 2e-3 * state[3], 0.0]
        np.testing.assert_allclose(flu @ moment, without, rtol=1e-5, atol=1e-9)


def test_rotor_links_and_base_have_mass_centre_and_inertia_of_the_whole(physical):
    mass, centre, inertia = join_rotors(split_rotors(physical, "Gazebo"))
    assert mass == pytest.approx(MASS, rel=1e-12)
    np.testing.assert_allclose(centre, 0.0, atol=1e-15)
    np.testing.assert_allclose(
        inertia, rotation_about_x() @ physical.inertia @ rotation_about_x().T, rtol=1e-9, atol=1e-18
    )


def test_an_impossible_inertia_is_refused_by_the_engines_that_reject_it(physical):
    flat = physical._replace(inertia=np.diag([8e-4, 8e-4, 2e-3]))
    for name in ("gazebo", "mjcf", "urdf"):
        with pytest.raises(DataError, match="'moment of inertia'"):
            SIMULATORS[name].write(flat)
    assert SIMULATORS["crazyflow"].write(flat)
    edge = split_rotors(physical._replace(inertia=np.diag([8e-4, 8e-4, 1.6e-3])), "Gazebo")
    assert edge.base_mass > 0.0


# ---- PX4 ----


def test_px4_signs_follow_its_reference(physical):
    values, _ = px4.parameters(physical)
    for i, (hub, spin) in enumerate(zip(physical.hubs, physical.spin)):
        assert np.sign(values[f"CA_ROTOR{i}_PX"]) == np.sign(hub[0])  # forward
        assert np.sign(values[f"CA_ROTOR{i}_PY"]) == np.sign(hub[1])  # right
        assert values[f"CA_ROTOR{i}_PZ"] == pytest.approx(-0.012)  # down
        assert (values[f"CA_ROTOR{i}_KM"] > 0.0) == (spin < 0.0)  # positive: counter-clockwise
        assert abs(values[f"CA_ROTOR{i}_KM"]) == pytest.approx(0.012, rel=1e-6)


@pytest.mark.parametrize("factor", [0.0, 0.3, 0.8])
def test_the_thrust_factor_is_found_from_a_map_that_follows_it(factor, physical):
    powers, u = range(8), np.linspace(0.0, 1.0, 400)
    speed = 2400.0 * np.sqrt(factor * u**2 + (1 - factor) * u)
    table = np.polynomial.Polynomial.fit(u, speed, 7).convert().coef
    mapped = physical._replace(command_map={"coefficients": table.tolist(), "powers": list(powers)})
    found, rms = px4.thrust_factor(mapped)
    assert found == pytest.approx(factor, abs=0.03) and rms < 0.02  # the map is a polynomial of degree 7


def test_a_vehicle_numbered_as_px4_s_gets_the_parameters_of_its_simulation(physical):
    assert not px4.is_px4_order(physical) and "SIH_MASS" not in px4.parameters(physical)[0]
    places = [[ARM, ARM, 0], [-ARM, -ARM, 0], [ARM, -ARM, 0], [-ARM, ARM, 0]]
    renumbered = physical._replace(hubs=np.array(places), spin=np.array([-1.0, -1.0, 1.0, 1.0]))
    values, _ = px4.parameters(renumbered)
    full = px4.full_speed(renumbered)
    assert full == pytest.approx(2500.0)  # the map at command 1
    assert values["SIH_T_MAX"] == pytest.approx(THRUST * full**2) and values["SIH_MASS"] == MASS
    assert values["SIH_L_ROLL"] == pytest.approx(ARM, rel=1e-6) and values["SIH_KDV"] == pytest.approx(0.12)
    assert px4.recover(px4.write(renumbered), renumbered).inertia == pytest.approx(physical.inertia)


# ---- Gazebo's specification ----

# elements by the SDFormat 1.9 specification: parent -> children that it may hold
SDF = {
    "sdf": {"model"}, "model": {"link", "joint", "plugin", "pose", "static"},
    "link": {"pose", "inertial", "visual", "collision"}, "inertial": {"pose", "mass", "inertia"},
    "inertia": {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}, "visual": {"geometry"}, "collision": {"geometry"},
    "geometry": {"box", "cylinder"}, "box": {"size"}, "cylinder": {"radius", "length"},
    "joint": {"parent", "child", "axis"}, "axis": {"xyz", "limit"}, "limit": {"lower", "upper"},
    # parameters that gz-sim's motor model reads
    "plugin": {"jointName", "linkName", "turningDirection", "timeConstantUp", "timeConstantDown", "maxRotVelocity",
               "motorConstant", "momentConstant", "rotorDragCoefficient", "rollingMomentCoefficient", "motorNumber",
               "rotorVelocitySlowdownSim", "commandSubTopic", "motorSpeedPubTopic", "motorType"},
}  # fmt: skip


def test_the_gazebo_model_holds_elements_of_the_specification_alone(physical):
    root = ElementTree.fromstring(gazebo.write(physical)["model.sdf"])
    assert root.tag == "sdf" and root.get("version") == "1.9"
    for parent in root.iter():
        assert {child.tag for child in parent} <= SDF.get(parent.tag, set()), parent.tag
    model = root.find("model")
    names = [e.get("name") for e in model]
    assert len(model.findall("plugin")) == 4 and len(set(names) - {None}) >= 9
    linked = {link.get("name") for link in model.findall("link")}
    assert all({j.findtext("parent"), j.findtext("child")} <= linked for j in model.findall("joint"))


SDFORMAT = Path(os.environ.get("QUASI_SDFORMAT", "/usr/share/sdformat12/1.9"))


def faults(spec, element, path="sdf"):
    """What an element has that SDFormat's own description of it does not allow, or lacks of what it requires."""
    known = {a.get("name"): a.get("required") for a in spec.findall("attribute")}
    found = [f"{path}: attribute {k}" for k in element.attrib if k not in known]
    found += [f"{path}: no attribute {k}" for k, need in known.items() if need == "1" and k not in element.attrib]
    if any(e.get("copy_data") == "true" for e in spec.findall("element")):
        return found
    children = {e.get("name"): (e, e.get("required")) for e in spec.findall("element")}
    for include in spec.findall("include"):
        part = ElementTree.parse(SDFORMAT / include.get("filename")).getroot()
        children[part.get("name")] = (part, include.get("required"))
    for name, (part, need) in children.items():
        own = element.findall(name)
        found += [f"{path}: no {name}"] if need == "1" and not own else []
        found += [f"{path}: {len(own)} of {name}"] if need in ("0", "1", "-1") and len(own) > 1 else []
        for child in own:
            sizes = {"double": 1, "vector3": 3, "pose": 6}
            if part.get("type") in sizes:
                assert len([float(v) for v in child.text.split()]) == sizes[part.get("type")]
            found += faults(part, child, f"{path}/{name}")
    return found + [f"{path}: {child.tag}" for child in element if child.tag not in children]


@pytest.mark.skipif(not SDFORMAT.is_dir(), reason=f"{SDFORMAT} is absent; apt-get install sdformat-sdf")
def test_the_gazebo_model_is_what_sdformat_s_own_description_allows(physical):
    spec = ElementTree.parse(SDFORMAT / "root.sdf").getroot()
    root = ElementTree.fromstring(gazebo.write(physical)["model.sdf"])
    assert faults(spec, root) == []
    ElementTree.SubElement(root.find("model/link"), "thrust")
    assert faults(spec, root) == ["sdf/model/link: thrust"]


# ---- the command ----


def test_the_command_prints_the_table_and_its_json(model, tmp_path, capsys):
    write_json(tmp_path / "models/made/standalone/model.json", model.document)
    assert main(["constants", "made", "-d", str(tmp_path), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["schema"] == "quasi.constants/1"
    assert table["constants"]["thrust coefficient"]["value"] == pytest.approx([THRUST], rel=1e-9)
    assert main(["constants", "made", "-d", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    for fact in facts(physical_constants(model)):
        assert f"\n{fact.key}" in printed and fact.unit in printed


def test_the_hover_speed_used_is_the_model_s(model, physical):
    assert physical.hover == find_hover_speed(model, model.airframe.max_rpm * model.airframe.logged_to_rad_s)
