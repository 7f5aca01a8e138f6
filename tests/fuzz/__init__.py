"""Fuzzing: hostile bytes, files and command lines, made from real ones, against what holds for every input.

    corpus.py      inputs as files: what was found once, and the captures of this project
    mutators.py    an input -> another one that is damaged inside its containers
    seeds.py       the inputs that each target begins with, and how one is changed
    targets.py     what is run on an input, and what must hold then
    two_ends.py    clients, programs and keys: what a target does beside the command that it runs
    engine.py      worker processes with limits of time and memory, their watchdog, the shrinking of findings
    coverage.py    the same targets, led by coverage (atheris)
    __main__.py    `make fuzz`, by the clock

`make test` replays the corpus alone (test_fuzz.py).
"""
