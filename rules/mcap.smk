"""MCAP files for Foxglove and PlotJuggler, with Foxglove's schemas, and PlotJuggler layouts.

Needs  filtered flights; results/parts/simulation/{simulation}/*; results/parts/gap/{gap}/*
Makes  results/mcap/flights/{quadrotor}/{flight}.mcap, results/mcap/simulations/{simulation}.mcap, results/mcap/gaps/{gap}
"""


rule mcap_flight:
    input:
        flight="results/filtered/{quadrotor}/withGravity/{flight}.parquet",
    output:
        recording="results/mcap/flights/{quadrotor}/{flight}.mcap",
        layout="results/mcap/flights/{quadrotor}/{flight}.plotjuggler.xml",
    log:
        "logs/mcap/flights/{quadrotor}/{flight}.log",
    params:
        settings=lambda w: ask(
            FOLDER.model_jobs.flight_trajectory, w.quadrotor, w.flight
        ),
        code=code("mcap_flight.py"),
    script:
        "../scripts/mcap_flight.py"


rule mcap_simulation:
    input:
        table="results/parts/simulation/{simulation}/flight.parquet",
        summary="results/parts/simulation/{simulation}/summary.json",
        model=simulation_model,
    output:
        recording="results/mcap/simulations/{simulation}.mcap",
        layout="results/mcap/simulations/{simulation}.plotjuggler.xml",
    log:
        "logs/mcap/simulations/{simulation}.log",
    params:
        contents=lambda w: contents([simulation_model(w)]),
        code=code("mcap_simulation.py"),
    script:
        "../scripts/mcap_simulation.py"


rule mcap_gap:
    input:
        flights=lambda w: calibrated(w.gap, HELD),
        model=gap_model,
        extended="results/parts/gap/{gap}/model.json",
        diagnosis="results/parts/gap/{gap}/diagnosis.json",
    output:
        directory("results/mcap/gaps/{gap}"),
    log:
        "logs/mcap/gaps/{gap}.log",
    params:
        masses=lambda w: ask(FOLDER.gap, w.gap)["masses"],
        horizon=lambda w: max(ask(FOLDER.gap, w.gap)["settings"]["horizons"]),
        contents=lambda w: contents([gap_model(w)]),
        code=code("mcap_gap.py"),
    script:
        "../scripts/mcap_gap.py"
