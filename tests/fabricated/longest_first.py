"""Which test files take longest: they are begun first, so that two workers end at about the same time.

`python -m pytest --durations=0` tells how long; a file that is not listed takes a few seconds.
"""

LONGEST_FIRST = (
    "cli/test_bench_grid.py",
    "cli/test_stopped.py",
    "cli/test_bench_paper.py",
    "pipeline/test_shutter_calibration.py",
    "loops/test_rendered_walks.py",
    "dynamics/clusters/test_rendered_scenes.py",
    "contracts/test_method_contracts.py",
    "bench/test_grid_workers.py",
    "pipeline/reports/test_run_page.py",
    "pipeline/test_repeatable.py",
    "dense/test_rendered_rooms.py",
    "test_docs.py",
    "cli/test_commands.py",
    "scenes/worlds/test_buildings.py",
    "cli/test_report.py",
    "test_site.py",
    "cli/test_process.py",
    "cli/test_calibrate.py",
    "presets/test_outside_methods.py",
    "cli/test_demo.py",
    "dense/test_dense_mapper.py",
    "pipeline/test_viewing.py",
    "contracts/test_presets_run.py",
    "optimize/test_readout.py",
    "pipeline/test_rolling_sequences.py",
    "cli/test_bench_shutter.py",
    "cli/test_warmup.py",
)
"""Below `tests`, the longest first."""
