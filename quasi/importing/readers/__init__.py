"""One file a log format. `registry` lists them; `reader` says what each of them declares."""
