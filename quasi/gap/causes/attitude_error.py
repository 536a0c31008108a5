"""An on-board attitude that leans after the apparent vertical."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="attitude_error",
    level="sensors",
    sentence="the on-board attitude tilts under sustained acceleration",
    equation="tilt = gain low-passed (z x a / g) / 1 s, earth axes",
    source="Mahony, Hamel & Pflimlin, IEEE TAC 53(5), 2008",
    parameters={"gain": Parameter("s", 0.0, "a", 0.0, 5.0)},
    channels=("ax", "ay"),
    rivals=("room_tilt", "accelerometer_bias"),
    tie_breaker="sustained accelerations in all directions",
    parts="all",
    sensor=Sensor(),
)
