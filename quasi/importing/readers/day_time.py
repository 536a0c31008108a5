"""Times of day as programs print them, 12-hour clocks in the language of the computer among them.

"2024-03-01 02.11.08.123 PM", "2024-03-01 02.11.08.123 下午", "14:11:08.5": the first number triple with dots or colons
that stands alone is the time; letters next to it are the half of the day, in a language that may not be known here.
"""

import re
from dataclasses import dataclass

SECONDS_PER_DAY = 86400.0
_TIME = re.compile(r"(?<![\d.:])(\d{1,2})[.:](\d{2})[.:](\d{2})(?!\d)(?:[.,](\d{1,9}))?")
_MORNING = frozenset("am a 上午 午前 凌晨 早上 오전 vorm vormittag πμ de fm sa ص dop ap".split())  # noqa: SIM905
_AFTERNOON = frozenset("pm p 下午 午後 午后 中午 晚上 오후 nachm nachmittag μμ du em ch م odp ip".split())  # noqa: SIM905


@dataclass(frozen=True)
class DayTime:
    """A time of day as printed: seconds since midnight it may mean (one, or two half a day apart), and the text."""

    seconds: tuple[float, ...]
    text: str


def read_day_time(text: str) -> DayTime | None:
    """The time of day in a text; None when there is none.

    An hour beyond 12, an hour 0, or a known word for the half of the day settle it. An unknown word leaves two, and so
    does no word at all for an hour from 1 to 12: 24-hour clocks print that too, so that reading stands first.
    """
    found = list(_TIME.finditer(text[:200]))
    if not found:
        return None
    match = found[-1]
    hour, minute, second = (int(match[i]) for i in (1, 2, 3))
    if hour > 23 or minute > 59 or second > 60:
        return None
    within = 60.0 * minute + second + (float(f"0.{match[4]}") if match[4] else 0.0)
    rest = text[: match.start()] + " " + text[match.end() :]
    word = re.sub(r"[\d\W_]+", "", rest).lower()
    plain = 3600.0 * hour + within
    early, late = 3600.0 * (hour % 12) + within, 3600.0 * (hour % 12 + 12) + within
    shown = text.strip()[:60]
    if hour == 0 or hour > 12:
        return DayTime((plain,), shown)
    if word in _MORNING:
        return DayTime((early,), shown)
    if word in _AFTERNOON:
        return DayTime((late,), shown)
    return DayTime((plain, late if plain == early else early), shown)


def clock(seconds: float) -> str:
    """HH:MM:SS of seconds since midnight, for messages.

    >>> clock(51068.4)
    '14:11:08'
    """
    whole = int(seconds % SECONDS_PER_DAY)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"
