"""The index page of a project folder.

Needs  nothing: it lists the flights, models, simulations and gaps that stand in the folder, and never makes them
Makes  results/index.html
"""


rule index:
    output:
        "results/index.html",
    log:
        "logs/index.log",
    params:
        # what stands there: a change makes the page stale, and no job waits for another
        found=lambda wildcards: list_sources("."),
        code=code("index.py"),
    script:
        "../scripts/index.py"
