"""Exports as C and as a Python file: the same numbers as the model; nothing in a model leaves its place in source."""

import ast
import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from export_models import EVERY_FUNCTION, MODELS, bundled, model, normalised
from hypothesis import given, settings
from hypothesis import strategies as st
from made_model import TERMS, document
from programs import script

from quasi.errors import ConfigError, DataError
from quasi.export import agreement, contents
from quasi.export.agreement import AGREEMENT_LIMIT, LIMIT_FLOAT32, compare, states_of, wrench_of
from quasi.export.c_source import c_files
from quasi.export.compiler import find_compiler, shared_library, write_files
from quasi.export.contents import check_exportable, differential_inputs, name_in_source
from quasi.export.listing import of_model
from quasi.export.naming import identifier, name_of, shown
from quasi.export.python_source import python_file
from quasi.export.running import check_c, check_python, run_c, run_python
from quasi.model.extensions import DEFAULT_LAG, actuators_of
from quasi.model.model import Model, read_model
from quasi.tables import read_json, write_json

ROOT = Path(__file__).parents[2]
compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


@pytest.fixture(scope="module", params=MODELS)
def exported(request):
    return MODELS[request.param]()


# ---- the same numbers ----


@compiler
def test_c_file_gives_the_model_s_numbers_in_both_precisions(exported):
    checks = check_c(exported, c_files(exported))
    assert [c.what for c in checks][:2] == ["C, double: forces and moments", "C, double: differential form"]
    for check in checks:
        assert check.agrees, check
        assert check.rows == 10_000 and check.limit == (LIMIT_FLOAT32 if "float" in check.what else AGREEMENT_LIMIT)


def test_python_file_gives_the_model_s_numbers_without_quasi(exported):
    for check in check_python(exported, *python_file(exported)):
        assert check.agrees and check.limit == 1e-12, check


@compiler
@pytest.mark.parametrize("make", [normalised, lambda: model({"Fz": TERMS["Fz"], "My": TERMS["My"]})])
def test_normalised_models_and_models_of_few_axes_are_exported(make):
    made = make()
    for check in [*check_c(made, c_files(made), 500), *check_python(made, *python_file(made), 500)]:
        assert check.agrees, check
    wrench = run_c(made, c_files(made), states_of(made, 3)).wrench
    lacking = [k for k, axis in enumerate(("Fx", "Fy", "Fz", "Mx", "My", "Mz")) if axis not in made.axes]
    assert np.isnan(wrench[:, lacking]).all() and np.isfinite(np.delete(wrench, lacking, 1)).all()


COVERED = {n: {"min": 0.0, "max": 2000.0, "percentiles": {"0.01": 1.0, "99.99": 1900.0}} for n in ("w1", "x")}
ODD = {
    "constants alone": lambda: model({axis: {"1": 0.5} for axis in TERMS}, envelope=COVERED),
    "one constant axis": lambda: model({**EVERY_FUNCTION, "Fx": {"1": 0.5}}, envelope=COVERED),
    "zero": lambda: model({axis: {"u": 0.0} for axis in TERMS}),
    "beyond the floats": lambda: model(
        {**EVERY_FUNCTION, "Fx": {"u*1e300*1e300": 1.0, "1/0*v": 1.0, "0/0*w": 1.0, "(u^20)^20": 1e-300, "2^u^v": 1.0}}
    ),
    "undefined here and there": lambda: model(
        {**EVERY_FUNCTION, "Fx": {"(0-1)^0.5*u": 1.0, "yaw^2": 1.0, "1e-320*u": 1.0, "u^-3": 1.0, "(u*v)^0.5": 2.0}}
    ),
    "deep": lambda: model({**EVERY_FUNCTION, "Fx": {"(" * 50 + "u" + "+1)" * 50: 1.0}}),
    "a pool of another kind": lambda: bundled(
        ROOT / "config/polynomials/polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM.json"
    ),
}


@compiler
@pytest.mark.parametrize("kind", ODD)
def test_odd_models_are_exported_like_any_other(kind):
    made = ODD[kind]()
    for check in [*check_c(made, c_files(made), 500), *check_python(made, *python_file(made), 500)]:
        assert check.agrees or "float" in check.what, check


@compiler
def test_covered_region_is_exported():
    plain = document()
    columns = ["u", "v", "w", "p", "q", "w1", "w2", "w3", "w4"]
    middle = np.array([0.0] * 5 + [1000.0] * 4)
    plain["envelope"] = {
        n: {"min": m - 5.0, "max": m + 5.0, "percentiles": {"0.01": m - 4.0, "99.99": m + 4.0}}
        for n, m in zip(columns, middle)
    }
    plain["envelope"]["U_p"] = {"min": -9e6, "max": 9e6, "percentiles": {"0.01": -1e4, "99.99": 1e4}}
    triangle = np.tril(np.random.default_rng(0).normal(size=(9, 9))) + 2 * np.eye(9)
    plain["joint envelope"] = {
        "names": columns,
        "mean": middle.tolist(),
        "whitening": triangle.tolist(),
        "limit": 40.0,
    }
    made = Model(plain)
    at = states_of(made, 500)
    reference, worst = made.distance(at.state, at.speeds, at.accelerations)
    assert len(set(worst)) > 2 and reference.max() > 0.4 and (reference == 0.0).any()
    for found in (run_c(made, c_files(made), at), run_python(made, *python_file(made), at)):
        np.testing.assert_allclose(found.distance[:, 0], reference, rtol=1e-12)


@compiler
def test_planted_sign_errors_are_found():
    made = MODELS["made"]()
    files, (name, text) = c_files(made), python_file(made)
    source = f"{name_in_source(made)}.c"
    for old, new, what in (
        ("Fz += N(-1.3e-06)", "Fz += N(1.3e-06)", "forces"),
        ("U_p = w2_3 + w2_4 - w2_1", "U_p = w2_3 + w2_4 + w2_1", "forces"),
        ("gyroscopic[2] -= h[1]", "gyroscopic[2] += h[1]", "differential form"),
    ):
        assert files[source].count(old) >= 1
        checks = check_c(made, {**files, source: files[source].replace(old, new)})
        wrong = [check for check in checks if not check.agrees]
        assert wrong and what in wrong[0].what and wrong[0].largest > 1e-2
        with pytest.raises(DataError, match="C export of model m differs from the model"):
            agreement.insist(agreement.report(made, "C", checks, []))
    old = "Mz = Mz + 2e-08*U_r"
    assert old in text
    wrong = [c for c in check_python(made, name, text.replace(old, "Mz = Mz - 2e-08*U_r")) if not c.agrees]
    assert [c.where for c in wrong] == ["Mz"]


@compiler
def test_what_float_cannot_hold_is_told_and_does_not_spoil_the_export():
    made = model({**TERMS, "Fx": {"u^20*w_tot^9": 1e-40}})
    checks = check_c(made, c_files(made), 200)
    found = agreement.report(made, "C", checks, [])
    agreement.insist(found)
    assert found["agrees"] is True and not checks[-1].agrees and not checks[-1].binding
    assert "DIFFERS  C, float: forces and moments: 200 rows" in agreement.as_text(found)


def test_comparison_takes_nan_for_nan_and_for_nothing_else():
    nan, inf = math.nan, math.inf
    assert compare("x", np.array([[nan, inf, 1.0]]), np.array([[nan, inf, 1.0]]), "abc").largest == 0.0
    for found in ([[1.0, inf, 1.0]], [[nan, -inf, 1.0]], [[nan, inf, nan]]):
        assert compare("x", np.array(found), np.array([[nan, inf, 1.0]]), "abc").largest == inf
    # 1 % of a small value beside a large one counts by a thousandth of the large one
    assert compare("x", np.array([[1.0], [1.01e-6]]), np.array([[1.0], [1e-6]]), "a").largest == pytest.approx(1e-5)


def test_python_file_takes_single_rows_and_refuses_wrong_shapes(tmp_path, monkeypatch):
    made = MODELS["every_function"]()
    name, text = python_file(made)
    (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    module = __import__(name.removesuffix(".py"))
    at = states_of(made, 4)
    row = {n: v[2] for n, v in at.extra.items()}
    for found, expected in zip(
        module.predict(at.state[2], at.speeds[2], None, row), made.predict(at.state[2], at.speeds[2], None, row)
    ):
        assert found.shape == (3,)
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(ValueError, match=r"state must be \(N, 12\), .* got \(4, 9\)"):  # z is read
        module.predict(at.state[:, :9], at.speeds, None, at.extra)
    with pytest.raises(ValueError, match=r"rotor_speeds must be \(4, 4\)"):
        module.predict(at.state, at.speeds[:, :3], None, at.extra)
    with pytest.raises(ValueError, match="needs the column 'battery_voltage'"):
        module.predict(at.state, at.speeds)
    assert module.DIFFERENTIAL_INPUTS == ("U_p", "U_q", "battery_voltage")


@compiler
def test_rotors_in_c_follow_delay_limits_and_lag(tmp_path):
    plain = document()
    plain["actuators"] = {
        "time constants up": {"value": [0.02, 0.025, 0.03, 0.035]},
        "time constants down": {"value": [0.04] * 4},
        "delay": {"value": 0.0065},
    }
    plain["airframe"] |= {"idle RPM": 300.0, "max RPM": 2000.0, "motor poles": 14}
    made = Model(plain)
    p, dt, steps = name_in_source(made), 0.002, 60
    commands = np.random.default_rng(1).uniform(100.0, 3500.0, (steps // 6, 4)).repeat(6, axis=0)
    write_files(tmp_path, c_files(made))
    table = ",".join(repr(float(c)) for c in commands.ravel())
    driver = f"""
    #include "{p}.h"
    #include <stdio.h>
    int main(void) {{
        static const double commands[] = {{{table}}};
        const double start[4] = {{900, 1000, 1100, 1200}};
        double speeds[4];
        {p}_rotors rotors;
        int k;
        if ({p}_rotors_start(&rotors, 0.0, start) == 0 || {p}_rotors_start(&rotors, 1e-6, start) == 0) return 2;
        if ({p}_rotors_start(&rotors, {dt}, start) != 0) return 3;
        for (k = 0; k < {steps}; k++) {{
            {p}_rotors_step(&rotors, commands + 4*k, speeds);
            printf("%.17g %.17g %.17g %.17g\\n", speeds[0], speeds[1], speeds[2], speeds[3]);
        }}
        return 0;
    }}"""
    (tmp_path / "main.c").write_text(driver)
    shared_library(
        tmp_path, ["main.c", f"{p}.c"], "run", flags=("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")
    )
    printed = subprocess.run([str(tmp_path / "run")], capture_output=True, text=True, check=True).stdout
    found = np.array([[float(x) for x in line.split()] for line in printed.splitlines()])
    # the commands of 6.5 ms ago, averaged over each step, limited, then the exact answer of a first-order lag
    factor, late = made.airframe.logged_to_rad_s, 0.0065
    speeds, start = np.array([900.0, 1000.0, 1100.0, 1200.0]), np.array([900.0, 1000.0, 1100.0, 1200.0])
    fine = 400
    for k in range(steps):
        times = k * dt - late + dt * (np.arange(fine) + 0.5) / fine
        rows = np.floor(times / dt).astype(int)
        wanted = np.where((rows < 0)[:, None], start, commands[np.maximum(rows, 0)]).mean(axis=0)
        wanted = np.clip(wanted, 300.0 * factor, 2000.0 * factor)
        tau = np.where(wanted > speeds, [0.02, 0.025, 0.03, 0.035], 0.04)
        speeds = wanted + (speeds - wanted) * np.exp(-dt / tau)
        np.testing.assert_allclose(found[k], speeds, rtol=1e-12)


@compiler
def test_c_file_compiles_without_a_warning_in_both_precisions(exported, tmp_path):
    files = c_files(exported)
    write_files(tmp_path, files)
    source = next(n for n in files if n.endswith(".c"))
    strict = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-c")
    for defines in ([], ["QUASI_FLOAT32"]):
        shared_library(tmp_path, [source], "object.o", defines, strict)
    assert "#include" in files[source] and not re.findall(r"#include <(?!math|stddef)", files[source])


# ---- constants ----


def test_constants_stand_in_si_and_mechanical_rad_per_second():
    made = Model(
        {
            **document(),
            "logged to rad/s": 1.5,
            "airframe": {**document()["airframe"], "idle RPM": 200.0, "max RPM": 2000.0},
        }
    )
    rotors = actuators_of(made)
    assert (rotors.lowest, rotors.highest) == (300.0, 3000.0)
    header = c_files(made)["quasi_m.h"]
    assert "eRPM/100: mechanical rad/s = 1.5 times" in header and "mechanical rad/s" in header
    assert "const real quasi_m_highest_speed = N(3000.0);" in c_files(made)["quasi_m.c"]
    bare = actuators_of(Model(document()))
    assert bare.highest == math.inf and any("'max RPM'" in note for note in bare.notes)
    assert (bare.up == DEFAULT_LAG).all(), "the same as a simulation takes"


def test_head_says_whether_gravity_is_to_be_added():
    with_it = contents.head(Model(document()))
    without = contents.head(Model({**document(), "gravity": "noGravity"}))
    assert any("gravity is to be" in line for line in with_it)
    assert any("must not add it" in line for line in without)


# ---- bad input ----


@settings(max_examples=150, deadline=None)
@given(st.text(alphabet="ax2d_-5f.+é\U0001f600|["))
def test_identifiers_are_legal_and_reversible(name):
    made = identifier(name, "quasi_")
    assert made.isascii() and made.isidentifier() and name_of(made, "quasi_") == name


@settings(max_examples=150, deadline=None)
@given(st.text())
def test_shown_text_stays_in_comments_and_strings(text):
    plain = shown(text)
    assert not set(plain) & set("\"'\\%?`\n\r\t\0") and "*/" not in plain and "/*" not in plain and "//" not in plain
    assert ast.literal_eval(f'"""{plain}"""') == plain


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "a/b", 'x"; system("rm -rf /"); "', "a\nb", "", ".hidden", "a b", "ä", "a*/b"]
)
def test_hostile_model_ids_are_refused(name, tmp_path):
    write_json(tmp_path / "model.json", {**document(), "id": name})
    with pytest.raises(ConfigError, match="'id' is"):
        read_model(tmp_path)


@compiler
def test_models_that_differ_by_the_case_of_letters_stand_in_one_program(tmp_path):
    sizes = []
    for name, delay in (("Bee", 0.0), ("bee", 0.02)):
        made = Model({**document(), "id": name, "actuators": {"delay": {"value": delay}}})
        write_files(tmp_path, c_files(made))
        sizes.append(round(delay / 0.0005) + 2)
    driver = """#include "quasi_Bee.h"
    #include "quasi_bee.h"
    #include <stdio.h>
    int main(void) {
        printf("%d %d\\n", quasi_Bee_DELAY_ROWS, quasi_bee_DELAY_ROWS);
        return quasi_Bee_EXTRA_INPUTS + quasi_bee_EXTRA_INPUTS + (quasi_Bee_mass != quasi_bee_mass);
    }"""
    (tmp_path / "main.c").write_text(driver)
    strict = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")
    shared_library(tmp_path, ["main.c", "quasi_Bee.c", "quasi_bee.c"], "run", flags=strict)
    printed = subprocess.run([str(tmp_path / "run")], capture_output=True, text=True, check=True).stdout
    assert [int(n) for n in printed.split()] == sizes


@pytest.mark.parametrize("name", ["HDBeetle-14", "5inch", "a.b+c", "int", "__x2d_"])
@compiler
def test_ids_that_are_no_identifiers_are_mapped(name):
    made = Model({**document(), "id": name})
    p = name_in_source(made)
    assert re.fullmatch(r"quasi_[A-Za-z0-9_]+", p) and name_of(p, "quasi_") == name
    at = states_of(made, 20)
    np.testing.assert_array_equal(run_c(made, c_files(made), at).wrench, wrench_of(made, at))
    np.testing.assert_array_equal(run_python(made, *python_file(made), at).wrench, wrench_of(made, at))


HOSTILE = '*/ int main(void) { return system("touch /tmp/x"); } /* """\n#include "x"\nimport os; os.abort() \\ ??/ %'


@compiler
def test_hostile_text_stays_in_comments():
    plain = document()
    plain["airframe"]["name"] = HOSTILE
    plain["notes"] = [HOSTILE]
    for part in plain["axes"].values():
        for term in part["terms"]:
            term["name"] = term["unit"] = HOSTILE
    made = Model(plain)
    files, (name, text) = c_files(made), python_file(made)
    bare = re.sub(r"/\*.*?\*/", "", "\n".join(files.values()), flags=re.S)
    assert "system" not in bare and "main" not in bare
    assert not [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Attribute) and n.attr == "abort"]
    at = states_of(made, 20)
    np.testing.assert_array_equal(run_c(made, files, at).wrench, wrench_of(made, at))
    np.testing.assert_array_equal(run_python(made, name, text, at).wrench, wrench_of(made, at))


@pytest.mark.parametrize(
    "expression", ["__import__('os')", "u; exit()", "system(1)", "u[0]()", "lambda: 0", "u*/*x*/v"]
)
def test_regressors_with_code_are_refused_when_read(expression):
    plain = document()
    plain["axes"]["Fx"]["terms"][0]["expression"] = expression
    with pytest.raises(ValueError, match="Fx"):
        Model(plain)


@compiler
def test_columns_with_names_of_the_source_s_own_variables_keep_their_numbers():
    made = "h d i j k I A B N turn inverse gyroscopic sum value low high whitening farthest found forces real NULL"
    columns = {name: {"min": 0.1, "max": 9.0, "percentiles": {"0.01": 0.2, "99.99": 8.0}} for name in made.split()}
    terms = {**TERMS, "Fx": dict.fromkeys(columns, 1.0), "Mx": {"U_p": 1e-7, **{f"{name}*p": 1.0 for name in columns}}}
    joint = {"names": ["h", "d"], "mean": [1.0, 1.0], "whitening": [[1.0, 0.0], [0.5, 1.0]], "limit": 4.0}
    found = model(terms, "own", envelope=columns, **{"joint envelope": joint})
    for check in [*check_c(found, c_files(found), 100), *check_python(found, *python_file(found), 100)]:
        assert check.agrees, check


@compiler
def test_columns_with_names_of_the_language_are_mapped():
    made = model(
        {**TERMS, "Fx": {"int*u": 1.0, "t1": 2.0, "state*v": 1.0, "a|b[c]": 1.0, "real": 0.1, "lambda": 1.0}}, "odd"
    )
    assert set(made.inputs[20:]) == {"int", "t1", "state", "a|b[c]", "real", "lambda"}
    at = states_of(made, 50)
    np.testing.assert_array_equal(run_c(made, c_files(made), at).wrench, wrench_of(made, at))
    np.testing.assert_array_equal(run_python(made, *python_file(made), at).wrench, wrench_of(made, at))
    assert "a|b[c]" in c_files(made)["quasi_odd.h"]


def test_extensions_with_states_are_refused_by_name():
    made = Model({**document(), "extensions": [{"id": "inflow lag", "states": ["inflow"]}]})
    for export in (c_files, python_file, check_exportable):
        with pytest.raises(ConfigError, match=r"'inflow lag' has states of its own \(inflow\)"):
            export(made)
    outside = Model({**document(), "extensions": [{"id": "drag", "terms": {"Fx": [{"expression": "u"}]}}]})
    with pytest.raises(ConfigError, match="'drag' do not stand among those of Fx"):
        check_exportable(outside)


@pytest.mark.parametrize("actuators", [{"time constants": {"value": "fast"}}, {"time constants": {"value": [0.0]}},
                                       {"delay": {"value": math.nan}}])  # fmt: skip
def test_damaged_actuators_are_refused(actuators):
    with pytest.raises(DataError, match="model m"):
        c_files(Model({**document(), "actuators": actuators}))


def test_without_a_compiler_the_sources_are_written_and_the_report_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    write_json(tmp_path / "model.json", document())
    script("export_c").main(str(tmp_path / "model.json"), str(tmp_path / "c"))
    found = read_json(tmp_path / "c/agreement.json")
    assert found["agrees"] is None and found["checks"] == [] and "no C compiler was found" in found["notes"][-1]
    assert (tmp_path / "c/quasi_m.c").is_file() and "not compared" in capsys.readouterr().out


def test_differential_inputs_are_the_model_s_else_the_rotor_speeds():
    assert differential_inputs(Model(document())) == ("w1", "w2", "w3", "w4")
    assert differential_inputs(MODELS["every_function"]()) == ("U_p", "U_q", "battery_voltage")
    assert differential_inputs(model({"Fx": TERMS["Fx"]})) == ()


def test_listing_keeps_the_names_of_variables_and_computes_nothing_twice():
    listing = of_model(MODELS["made"]())
    steps = dict(listing.steps)
    assert {"U_p", "U_q", "U_r", "u_r", "w_tot"} <= set(steps)
    assert len(set(steps.values())) == len(steps)
    assert listing.functions == {"*", "+", "-", "/", "sqrt", "abs"}
    assert "battery_voltage" in of_model(model(EVERY_FUNCTION)).inputs
