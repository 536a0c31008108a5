"""Commands of `quasi`: their options, and what each calls. Rooms are imported when a command runs."""
