"""Settings that hold for every test: the same examples on every run, and no wall-clock deadlines."""

from hypothesis import settings

settings.register_profile("deterministic", derandomize=True, deadline=None, max_examples=60)
settings.load_profile("deterministic")


def pytest_addoption(parser):
    parser.addoption("--bless", action="store_true", help="fly the golden flights again and keep them")
