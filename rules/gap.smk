"""What a model gets wrong on measured flights, why, and the model extended by it.

Needs  config/gaps/{gap}.json, models/{model}/standalone/model.json, the imported and filtered flights and their raw files
Makes  results/calibrations/{gap}.json, what sensors and rotor drive were found to be wrong by; then the same flights
       processed anew, results/calibrated/{gap}/imported|filtered; then results/parts/gap/{gap}/*, gathered into
       results/gaps/{gap}; models/{extended model ID}/standalone is made as any model is
"""

# the catalogue finds its causes in their folder, not by imports that the digest of a script could follow
CATALOGUE = [
    compute_code_digest(str(path), LIBRARY)
    for path in sorted(Path(LIBRARY, "quasi/gap/causes").glob("*.py"))
]


def own_effects(wildcards):
    asked = ask(FOLDER.gap, wildcards.gap)
    announce(describe_run_code(asked))
    for notice in ask(FOLDER.gaps.changed_selection, wildcards.gap):
        announce(notice)
    files = asked["effect files"]
    # an absent one fails the job with a sentence
    return [path for path in files if Path(path).is_file()]


rule gap_calibration:
    input:
        own=own_effects,
        model=gap_model,
        imported=lambda w: as_processed(w.gap, LEARN, "imported"),
        imported_metadata=lambda w: as_processed(w.gap, LEARN, "imported", "json"),
        filtered=lambda w: as_processed(w.gap, LEARN, "withGravity"),
        filtered_metadata=lambda w: as_processed(w.gap, LEARN, "withGravity", "json"),
        recordings=gap_recordings,
        raw=learning_files,
    output:
        calibration="results/calibrations/{gap}.json",
        tables=directory("results/parts/gap/{gap}/sensors"),
    log:
        "logs/gap/{gap}/calibration.log",
    benchmark:
        "results/benchmarks/gap/{gap}/calibration.tsv"
    params:
        asked=lambda w: ask(FOLDER.gap, w.gap),
        settings=lambda w: learning_settings(w.gap),
        names=row_names,
        contents=lambda w: contents(
            [*own_effects(w), gap_model(w), *gap_recordings(w), *learning_files(w)]
        ),
        code=code("gap_calibration.py"),
        causes=CATALOGUE,
    script:
        "../scripts/gap_calibration.py"


rule gap_importing:
    input:
        calibration="results/calibrations/{gap}.json",
        flight="results/imported/{quadrotor}/{flight}.parquet",
        metadata="results/imported/{quadrotor}/{flight}.json",
        raw=raw_files,
    output:
        flight="results/calibrated/{gap}/imported/{quadrotor}/{flight}.parquet",
        metadata="results/calibrated/{gap}/imported/{quadrotor}/{flight}.json",
    log:
        "logs/gap/{gap}/importing/{quadrotor}/{flight}.log",
    params:
        settings=lambda w: ask(FOLDER.recordings.importing, w.quadrotor, w.flight),
        role=lambda w: ask(FOLDER.gaps.roles, w.gap).get(w.flight),
        contents=lambda w: contents(raw_files(w)),
        code=code("gap_importing.py"),
    script:
        "../scripts/gap_importing.py"


rule gap_filtering:
    input:
        flight="results/calibrated/{gap}/imported/{quadrotor}/{flight}.parquet",
        metadata="results/calibrated/{gap}/imported/{quadrotor}/{flight}.json",
        with_gravity="results/filtered/{quadrotor}/withGravity/{flight}.parquet",
        with_gravity_metadata="results/filtered/{quadrotor}/withGravity/{flight}.json",
        no_gravity="results/filtered/{quadrotor}/noGravity/{flight}.parquet",
        no_gravity_metadata="results/filtered/{quadrotor}/noGravity/{flight}.json",
    output:
        with_gravity="results/calibrated/{gap}/filtered/{quadrotor}/withGravity/{flight}.parquet",
        with_gravity_metadata="results/calibrated/{gap}/filtered/{quadrotor}/withGravity/{flight}.json",
        no_gravity="results/calibrated/{gap}/filtered/{quadrotor}/noGravity/{flight}.parquet",
        no_gravity_metadata="results/calibrated/{gap}/filtered/{quadrotor}/noGravity/{flight}.json",
    log:
        "logs/gap/{gap}/filtering/{quadrotor}/{flight}.log",
    params:
        settings=lambda w: ask(FOLDER.recordings.filtering, w.quadrotor, w.flight),
        code=code("gap_filtering.py"),
    script:
        "../scripts/gap_filtering.py"


rule gap_diagnosis:
    input:
        own=own_effects,
        model=gap_model,
        calibration="results/calibrations/{gap}.json",
        flights=lambda w: calibrated(w.gap),
        metadata=lambda w: calibrated(w.gap, kind="json"),
        held_imported=lambda w: calibrated(w.gap, HELD, "imported"),
        held_imported_metadata=lambda w: calibrated(w.gap, HELD, "imported", "json"),
        held_filtered=lambda w: calibrated(w.gap, HELD, "withGravity"),
        held_filtered_metadata=lambda w: calibrated(w.gap, HELD, "withGravity", "json"),
        first_imported=lambda w: as_processed(w.gap, HELD, "imported"),
        first_imported_metadata=lambda w: as_processed(w.gap, HELD, "imported", "json"),
        first_filtered=lambda w: as_processed(w.gap, HELD, "withGravity"),
        first_filtered_metadata=lambda w: as_processed(
            w.gap, HELD, "withGravity", "json"
        ),
    output:
        diagnosis="results/parts/gap/{gap}/diagnosis.json",
        model="results/parts/gap/{gap}/model.json",
        partition="results/parts/gap/{gap}/partition.parquet",
        tables=directory("results/parts/gap/{gap}/tables"),
    log:
        "logs/gap/{gap}/diagnosis.log",
    benchmark:
        "results/benchmarks/gap/{gap}/diagnosis.tsv"
    params:
        asked=lambda w: ask(FOLDER.gap, w.gap),
        contents=lambda w: contents([*own_effects(w), gap_model(w)]),
        code=code("gap_diagnosis.py"),
        causes=CATALOGUE,
    script:
        "../scripts/gap_diagnosis.py"


rule gap_figures:
    input:
        diagnosis="results/parts/gap/{gap}/diagnosis.json",
        tables="results/parts/gap/{gap}/tables",
    output:
        directory("results/parts/gap/{gap}/figures"),
    log:
        "logs/gap/{gap}/figures.log",
    threads: 2
    params:
        code=code("gap_figures.py"),
    script:
        "../scripts/gap_figures.py"


rule gap_report:
    input:
        own=own_effects,
        diagnosis="results/parts/gap/{gap}/diagnosis.json",
        model="results/parts/gap/{gap}/model.json",
        tables="results/parts/gap/{gap}/tables",
        sensors="results/parts/gap/{gap}/sensors",
        figures="results/parts/gap/{gap}/figures",
    output:
        "results/parts/gap/{gap}/report.html",
    log:
        "logs/gap/{gap}/report.log",
    params:
        files=lambda w: ask(FOLDER.gap, w.gap)["effect files"],
        contents=lambda w: contents(own_effects(w)),
        code=code("gap_report.py"),
        causes=CATALOGUE,
    script:
        "../scripts/gap_report.py"


rule gap:
    input:
        inspected=lambda w: inspected("gaps", w.gap),
        diagnosis="results/parts/gap/{gap}/diagnosis.json",
        report="results/parts/gap/{gap}/report.html",
        model="results/parts/gap/{gap}/model.json",
        calibration="results/calibrations/{gap}.json",
        tables="results/parts/gap/{gap}/tables",
        sensors="results/parts/gap/{gap}/sensors",
        figures="results/parts/gap/{gap}/figures",
    output:
        folder=directory("results/gaps/{gap}"),
        diagnosis="results/gaps/{gap}/diagnosis.json",
        report="results/gaps/{gap}/report.html",
    log:
        "logs/gap/{gap}/gap.log",
    params:
        code=code("gap.py"),
    script:
        "../scripts/gap.py"
