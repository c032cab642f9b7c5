# Common tasks. Run `just` for the list. Each recipe also works as the command that it shows.

_default:
    @just --list --unsorted

# Make .venv with everything the tests need
setup:
    bash -c 'source script/lib/setup.sh && setup test'

# Run the tests. Example: just test tests/sim -x
test *arguments:
    script/test {{ arguments }}

# Check style, types and the borders between the parts
lint: setup
    .venv/bin/ruff check .
    .venv/bin/ruff format --check .
    .venv/bin/mypy
    .venv/bin/lint-imports

# Build the wheels and sdists of all parts into dist/
wheels:
    script/wheels

# Build the documentation's site into site/
docs: setup
    NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

# Run the benchmark with the baselines. Example: just demo --suite smoke@3
demo *arguments:
    script/demo {{ arguments }}

# Run one benchmark. Example: just bench decision
bench name *arguments: setup
    .venv/bin/python benchmarks/{{ name }}{{ if path_exists("benchmarks" / name) == "true" { "" } else { ".py" } }} {{ arguments }}
