"""Flights whose own sources contradict each other take no part in a gap: nothing can be learnt or judged on them.

What a flight merely lacks (velocity, rotor speeds) is weighed by each level on its own and is no matter of this module.
"""

from collections.abc import Mapping
from typing import Any

from quasi.errors import DataError
from quasi.identification.shared import USE_UNUSABLE
from quasi.project.gaps import COMPARED, HELD
from quasi.sensor_limits import first_reason, list_reasons

FEWEST_COMPARED = 2  # flights: a cause must recur in another flight to be found (docs/gaps.md)


def exclude_unusable(
    flights: Mapping[str, Mapping[str, Any]], roles: Mapping[str, str], where: str, use: bool = False
) -> dict[str, str]:
    """{flight: why} of flights whose sources contradict each other; {} where `use` is true.

    flights  {key: metadata of its filtered table}; roles  {key: "compared", "held out", "reference"}
    where    file of the gap's configuration
    Raises DataError where exclusion leaves fewer than 2 compared flights, or none of the reference flights. A held-out
    flight is left out whatever remains: without any, the diagnosis says that nothing could be judged.
    """
    if use:
        return {}
    found = {
        key: first_reason(sentences)
        for key, made in flights.items()
        if (sentences := list_reasons(made.get("contradictions") or []))
    }
    for role in dict.fromkeys(roles[key] for key in flights):
        of_role = [key for key in flights if roles[key] == role]
        out = [key for key in of_role if key in found]
        needed = FEWEST_COMPARED if role == COMPARED else 1
        if role == HELD or not out or len(of_role) - len(out) >= needed:
            continue
        listed = "; ".join(f"flight {key}: {found[key]}" for key in out)
        raise DataError(
            f"{where}: {len(of_role) - len(out)} of {len(of_role)} {role} flights "
            f"{'is' if len(of_role) - len(out) == 1 else 'are'} usable, expected at least {needed}: {listed}; correct "
            f"the recordings or their configuration, name other flights, or set '{USE_UNUSABLE}' to true"
        )
    return found


def exclusion_notes(left_out: Mapping[str, str], roles: Mapping[str, str]) -> list[str]:
    """A sentence for each flight of `exclude_unusable`."""
    notes = []
    for key, why in left_out.items():
        lost = "it judges nothing" if roles[key] == HELD else "no cause is learnt from it"
        notes.append(f"flight {key} is unusable and left out, {lost}; {why}; '{USE_UNUSABLE}' would force it")
    return notes
