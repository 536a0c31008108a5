"""The command line itself: help, and a name that no command has."""

import pytest

from quasi.command import main


def test_without_arguments_help_is_printed(capsys):
    assert main([]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("usage: quasi") and "check" in printed and "summary" in printed


@pytest.mark.parametrize(("given", "meant"), [("chek", "check"), ("sumary", "summary"), ("Check", "check")])
def test_a_name_that_no_command_has_is_answered_with_the_nearest(capsys, given, meant):
    assert main([given, "x"]) == 2
    assert f"no command '{given}' (did you mean '{meant}'?)" in capsys.readouterr().err
