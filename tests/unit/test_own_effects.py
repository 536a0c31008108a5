"""A cause of a user's own: what is wrong with its file is told before any flight is read."""

import os
import signal
from dataclasses import fields

import numpy as np
import pytest
from made_plan import MODEL, VEHICLE, eight, follow

from quasi.errors import ConfigError, DataError
from quasi.gap.catalogue import catalogue, columns_of
from quasi.gap.effect import Effect, Parameter
from quasi.gap.flights.gathering import gather
from quasi.gap.own_effect import FUNCTIONS, effect_of

SOUND = {
    "id": "'sticky'", "level": "'forces'", "sentence": "'s'", "equation": "'e'", "source": "'s'", "channels": "('Fx',)",
    "parameters": "{'k': Parameter('N', 0.0, 'a', 0.0, 1.0, 0.1)}", "terms": "lambda vehicle: {'k': {'Fx': 'u'}}",
}  # fmt: skip


def text(**changes):
    parts = ", ".join(f"{key}={value}" for key, value in {**SOUND, **changes}.items() if value)
    return f"from quasi.gap.effect import Effect, Parameter\nEFFECT = Effect({parts})\n"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "sticky.py"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("import sys; sys.exit(3)\n", "it would end the whole program (SystemExit: 3); correct the file"),
        ("raise KeyboardInterrupt\n", "it would end the whole program (KeyboardInterrupt); correct the file"),
        (text(terms="lambda vehicle: exit(0)"), "effect 'sticky': it would end the whole program (SystemExit: 0)"),
        (text(parameters="{'k': Parameter('N', 0.0, 'a', 0.0, 1.0, lambda v: exit(1))}"), "(SystemExit: 1)"),
        (text(id="'../../evil'"), "effect '../../evil': the id may hold"),
        (text(id="'<b>'"), "effect '<b>': the id may hold"),
        (text(id="None"), "effect None: the id may hold"),
        (text(id="'tether'"), "the id 'tether' is taken by a built-in cause; choose another"),
        (text(level="'sensors'"), "level is 'sensors', expected 'forces'"),
        (text(sentence="3"), "sentence is 3, expected text"),
        (text(parts="'some'"), "parts is 'some', expected one of any, all, alike, first, one"),
        (text(channels="('fx',)"), "channel 'fx' is no axis (did you mean 'Fx'?)"),
        (text(channels="('Fx', 'Fz')"), "channels name Fz, but its terms act on Fx alone"),
        (text(rivals="('translational_lif',)"), "'translational_lif', which no cause has as its id (did you mean"),
        (text(parameters="{'k': ('N', 0, 'a', 0, 1)}"), "expected Parameter(unit, neutral, ...)"),
        (text(parameters="{'k': Parameter('N', 5.0, 'a', 0.0, 1.0)}"), "neutral is 5.0, expected a value from 0"),
        (text(parameters="{'k': Parameter('N', 0.0, 'a', 0.0, 1.0, 0.0)}"), "its typical size is 0.0"),
        (text(parameters="{'k': Parameter('N', 0.0, 'a', 0.0, 1.0, lambda v: v.mas)}"), "no attribute 'mas'"),
        (text(parameters="{}"), "it has no parameter"),
        (text(starts="(0.1,)"), "starts = (0.1,), expected sizes other than 0 of its only parameter, and the whole"),
        (text(starts="(0.0,)", nonlinear_terms="lambda vehicle, values: {'Fx': 'u'}"), "expected sizes other than 0"),
        (text(terms=None), "expected terms or columns"),
        (text(terms="{'k': {'Fx': 'u'}}"), "expected a function"),
        (text(terms="lambda vehicle: 1 / 0"), "ZeroDivisionError: division by zero"),
        (text(terms="lambda vehicle: {'q': {'Fx': 'u'}}"), "expected {parameter: ...} for k"),
        (text(terms="lambda vehicle: {'k': 'u'}"), "parameter 'k' gives 'u', expected {axis: expression}"),
        (text(terms="lambda vehicle: {'k': {'FX': 'u'}}"), "'FX' is no axis (did you mean 'Fx'?)"),
        (text(terms="lambda vehicle: {'k': {'Fx': 'heigt'}}"), "Fx: unknown variable 'heigt'"),
        (text(terms="lambda vehicle: {'k': {'Fx': 'u**'}}"), "'**' is not an operator"),
        (text(nonlinear_terms="lambda vehicle, values: {'Fx': 'k*'}"), "nonlinear_terms(vehicle, values), Fx: "),
        (text(terms=None, columns="lambda evidence, values: {}"), "columns need an extension as well"),
        (text(sums="[({'k': 1.0}, 0.0)]"), "expected a function"),
        (text(sums="lambda vehicle: [({'kk': 1.0}, 0.0)]"), "sums(vehicle) names 'kk', which is no parameter"),
    ],
)
def test_a_faulty_file_is_refused_with_its_name_and_a_sentence(path, content, words):
    path.write_text(content)
    with pytest.raises(ConfigError) as caught:
        catalogue([path])
    assert f"effect file {path}: " in str(caught.value) and words in str(caught.value)


def test_an_absent_file_is_told_as_such(path):
    with pytest.raises(ConfigError, match=r"sticky\.py does not exist; correct 'effect files'"):
        effect_of(path)


def test_a_file_counts_as_it_stands_and_nothing_is_left_beside_it(path):
    for sentence in ("'one'", "'two'"):  # as long as each other, and of the same second
        path.write_text(text(sentence=sentence))
        os.utime(path, (1e9, 1e9))
        assert effect_of(path).sentence == sentence.strip("'")
    assert [p.name for p in path.parent.iterdir()] == ["sticky.py"]


def test_every_cause_of_forces_and_moments_in_the_catalogue_would_pass_as_a_users(path):
    for name, effect in catalogue().items():
        if effect.level == "forces" and not effect.finding:
            path.write_text(f"from quasi.gap.causes.{name} import EFFECT\n")
            own = effect_of(path)
            assert {f.name for f in fields(Effect) if getattr(own, f.name) != getattr(effect, f.name)} <= {*FUNCTIONS}


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (lambda evidence, values: {"k": evidence.nothing}, "AttributeError"),
        (lambda evidence, values: {"k": evidence.t}, r"shapes \{'k': \(\d+,\)\}, expected \{'k': \(\d+, 6\)\}"),
        (lambda evidence, values: {"q": evidence.only("Fx", 1.0)}, r"expected \{'k': "),
        (lambda evidence, values: {"k": evidence.only("Fx", np.nan)}, r"no finite number at t = 0\.00 s of flight a"),
    ],
)
def test_columns_that_are_none_are_told_with_cause_and_flight(columns, words):
    effect = Effect("sticky", "forces", "s", "e", "s", {"k": Parameter("N", 0.0, "a", 0.0, 1.0)}, columns=columns)
    with pytest.raises(DataError, match=words) as caught:
        columns_of(effect, gather("a", follow(eight(3.0)), {}, MODEL.airframe, MODEL, 100.0), VEHICLE, {})
    assert "effect 'sticky'" in str(caught.value)


@pytest.mark.parametrize("ends", ["exit(0)", "(_ for _ in ()).throw(KeyboardInterrupt)"])
def test_a_function_that_would_end_the_program_on_a_flight_is_told_with_its_file(path, ends):
    functions = f"lambda evidence, values: {ends}"
    path.write_text(text(terms=None, columns=functions, extension="lambda values, vehicle, model: None"))
    flight = gather("a", follow(eight(3.0)), {}, MODEL.airframe, MODEL, 100.0)
    with pytest.raises(ConfigError, match=r"sticky\.py, columns: it would end the whole program \((Sys|Key)"):
        columns_of(effect_of(path), flight, VEHICLE, {})


@pytest.fixture
def ctrl_c():
    """Ctrl-C as Python has it; what a shell starts in the background ignores it."""
    of_shell = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, of_shell)


@pytest.mark.parametrize("while_reading", [True, False])
def test_a_real_ctrl_c_in_a_users_file_stays_one(path, while_reading, ctrl_c):
    before = signal.getsignal(signal.SIGINT)
    press = "import signal\nsignal.raise_signal(signal.SIGINT)\n"
    if while_reading:
        path.write_text(press)
        with pytest.raises(KeyboardInterrupt):
            effect_of(path)
    else:
        called = "lambda evidence, values: __import__('signal').raise_signal(2)"
        path.write_text(text(terms=None, columns=called, extension="lambda values, vehicle, model: None"))
        flight = gather("a", follow(eight(3.0)), {}, MODEL.airframe, MODEL, 100.0)
        with pytest.raises(KeyboardInterrupt):
            columns_of(effect_of(path), flight, VEHICLE, {})
    assert signal.getsignal(signal.SIGINT) is before
