"""Causes of a user's own: a Python file is run, and what it defines is tried before hours are spent on flights."""

import functools
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np

from quasi.errors import ConfigError, QuasiError, nearest
from quasi.gap.effect import Effect, Room, Vehicle
from quasi.model.model import AXES
from quasi.terms.variables import check_expression

FUNCTIONS = (
    "terms",
    "columns",
    "nonlinear_terms",
    "full_effect",
    "extension",
    "sums",
)  # of an effect, which a user writes
TRIAL_ARM = 0.06  # m
# about that of the bundled example: what an effect makes of it is not used, only whether it makes sense
TRIED = Vehicle(
    hubs=TRIAL_ARM * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]]),
    spin=np.array([1.0, -1.0, -1.0, 1.0]),
    radius=0.04,
    thrust=2.4e-7,
    torque=3e-9,
    mass=0.43,
    inertia=np.diag([9e-4, 1.1e-3, 1.7e-3]),
    hover_induced=9.0,
    drawn=1e-9,
    inflow=1e-7,
    room=Room((-5.0, 5.0), (-5.0, 5.0), 5.0),
)


class Fresh(SourceFileLoader):
    """Takes a file as it stands: cached byte code may be of another text of the same second and length."""

    def get_code(self, fullname: str) -> CodeType:
        """Its code, from the text."""
        return self.source_to_code(self.get_data(self.path), self.path)


@contextmanager
def _own_code(where: str = "") -> Iterator[None]:
    """Run a user's code: where it would end the program, it raises a ConfigError instead. A Ctrl-C stays one.

    where  what the error begins with; without it the caller says where and how to correct it
    """
    pressed: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    # only the main thread receives a Ctrl-C, and only where a handler makes an exception of it
    watched = threading.current_thread() is threading.main_thread() and callable(before)

    def press(number: int, frame: Any) -> None:
        pressed.append(number)
        before(number, frame)

    if watched:
        signal.signal(signal.SIGINT, press)
    try:
        yield
    except Exception:
        raise
    except BaseException as error:
        if pressed and isinstance(error, KeyboardInterrupt):
            raise
        reason = f"{type(error).__name__}: {error}".removesuffix(": ")
        remedy = "; correct the file" if where else ""
        raise ConfigError(f"{where}it would end the whole program ({reason}){remedy}") from error
    finally:
        if watched:
            signal.signal(signal.SIGINT, before)


def _guarded(function: Callable[..., Any], where: str) -> Callable[..., Any]:
    """The same function, which cannot end the program when it is called on a flight."""

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        with _own_code(f"{where}: "):
            return function(*arguments, **named)

    return call


def effect_of(path: Path) -> Effect:
    """The cause that a file defines as EFFECT; the file is run. Raises ConfigError naming it and what is wrong."""
    if not path.is_file():
        raise ConfigError(f"effect file {path} does not exist; correct 'effect files', or put it there")
    name = f"quasi_own_effect_{path.stem}"
    module = module_from_spec(spec_from_file_location(name, path, loader=Fresh(name, str(path))))
    try:
        with _own_code():
            module.__spec__.loader.exec_module(module)
    except Exception as error:  # whatever the file does wrong
        raise ConfigError(f"effect file {path}: {_words(error)}; correct the file") from error
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise ConfigError(f"effect file {path} defines no EFFECT = Effect(...); see quasi/gap/causes for examples")
    try:
        with _own_code():
            problem = _fault(effect)
    except Exception as error:  # its functions are the user's
        problem = _words(error)
    if problem:
        raise ConfigError(f"effect file {path}: effect '{effect.id}': {problem}; correct the file")
    own = {word: getattr(effect, word) for word in FUNCTIONS if getattr(effect, word) is not None}
    effect = replace(effect, channels=effect.channels or AXES)  # none named: it may show in all
    return replace(effect, **{word: _guarded(f, f"effect file {path}, {word}") for word, f in own.items()})


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, QuasiError) else f"{type(error).__name__}: {error}"


def _fault(effect: Effect) -> str:
    """What is wrong with a cause, or nothing; its functions are tried on a usual vehicle, but for those of flights."""
    if effect.finding:
        return "finding is True, but a finding is never fitted; leave it out"
    if effect.level != "forces":
        return f"level is '{effect.level}', expected 'forces': a cause of one's own acts as a force or a moment"
    if not effect.fitted:
        return "it has no parameter; give one that can be fitted"
    if effect.terms is None and effect.columns is None:
        return "expected terms or columns, which say what each parameter adds to forces and moments"
    for word in FUNCTIONS:
        given = getattr(effect, word)
        if given is not None and not callable(given):
            return f"{word} is {given!r}, expected a function"
    if effect.terms is None and effect.extension is None and effect.nonlinear_terms is None:
        return "columns need an extension as well, which says what the cause adds to a model"
    for axis in effect.channels:
        if axis not in AXES:
            return f"channel '{axis}' is no axis{nearest(axis, AXES)}"
    for name, size in effect.typical(TRIED).items():
        if not np.isfinite(size) or size == 0.0:
            return f"parameter '{name}': its typical size is {size}, expected a number other than 0, or None"
    for weights, _ in effect.sums(TRIED) if effect.sums else ():
        for name in weights:
            if name not in effect.fitted:
                return f"sums(vehicle) names '{name}', which is no parameter{nearest(name, effect.fitted)}"
    if effect.terms is not None:
        made = effect.terms(TRIED)
        if not isinstance(made, Mapping) or set(made) != set(effect.fitted):
            return f"terms(vehicle) gives {_short(made)}, expected {{parameter: ...}} for {', '.join(effect.fitted)}"
        for name, wrench in made.items():
            if not wrench and effect.columns is not None:
                continue  # a parameter that only its columns have
            if problem := _wrench_fault(wrench, f"terms(vehicle), parameter '{name}'"):
                return problem
        acts = [a for a in AXES if any(a in wrench for wrench in made.values())]
        for axis in effect.channels:
            if axis not in acts:
                return f"channels name {axis}, but its terms act on {', '.join(acts)} alone"
    if effect.nonlinear_terms is not None:
        return _wrench_fault(
            effect.nonlinear_terms(TRIED, dict.fromkeys(effect.parameters, 0.01)), "nonlinear_terms(vehicle, values)"
        )
    return ""


def _wrench_fault(wrench: Any, where: str) -> str:
    """What is wrong with {axis: expression}, or nothing. Raises ExpressionError for one that means nothing."""
    if not isinstance(wrench, Mapping) or not wrench:
        return f"{where} gives {_short(wrench)}, expected {{axis: expression}}"
    for axis, text in wrench.items():
        if axis not in AXES:
            return f"{where}: '{axis}' is no axis{nearest(axis, AXES)}"
        check_expression(text, f"{where}, {axis}")
    return ""


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
