"""What is remembered is what would be worked out again, and no more than a bounded lot of it."""

from dataclasses import dataclass

import numpy as np
import pytest

from kffa_offboard.control.memory import LARGEST, REMEMBERED, remember


@dataclass(frozen=True, eq=False)
class Parameters:
    gain: float


class Work:
    """A remembered function, and how often it was really carried out."""

    def __init__(self) -> None:
        self.done = 0
        self.of = remember(self._carried_out)

    def _carried_out(self, *arguments: object) -> tuple[np.ndarray, int]:
        self.done += 1
        return np.zeros(3), self.done


@pytest.fixture
def work() -> Work:
    return Work()


def test_equal_arrays_are_worked_out_once(work: Work) -> None:
    first = work.of(np.array([0.01, 0.02]), 0.01)
    assert work.of(np.array([0.01, 0.02]), 0.01) is first
    assert work.done == 1


@pytest.mark.parametrize(
    "other",
    [np.array([0.0, 1.0]), np.array([[0.0], [0.0]]), np.array([0, 0]), np.array([-0.0, 0.0])],
    ids=["value", "shape", "type", "sign of zero"],
)
def test_another_array_is_another_question(work: Work, other: np.ndarray) -> None:
    work.of(np.zeros(2))
    work.of(other)
    assert work.done == 2


def test_an_array_that_was_written_into_is_another_question(work: Work) -> None:
    fresh = np.array([True, False])
    work.of(fresh)
    fresh[1] = True
    work.of(fresh)
    assert work.done == 2


def test_parameters_count_by_identity(work: Work) -> None:
    one, like_it = Parameters(2.0), Parameters(2.0)
    work.of(one)
    work.of(one)
    assert work.done == 1
    work.of(like_it)
    assert work.done == 2


def test_only_so_many_results_are_kept_and_what_was_not_asked_for_the_longest_goes_first(work: Work) -> None:
    for number in range(REMEMBERED):
        work.of(number)
    work.of(0)
    work.of(REMEMBERED)  # 1 goes
    work.of(0)
    assert work.done == REMEMBERED + 1
    work.of(1)
    assert work.done == REMEMBERED + 2


def test_what_is_asked_for_again_and_again_is_never_forgotten(work: Work) -> None:
    """The gain of the usual time is one of hundreds: telemetry with odd times has a new one in each step."""
    for number in range(1, 3 * REMEMBERED):
        work.of(0)
        work.of(number)
    assert work.done == 3 * REMEMBERED


def test_a_batch_of_many_flights_is_not_kept_and_takes_nothings_place(work: Work) -> None:
    work.of(0.01)
    for _ in range(REMEMBERED):
        work.of(np.zeros(LARGEST + 1))
    assert work.done == 1 + REMEMBERED
    work.of(0.01)
    assert work.done == 1 + REMEMBERED


def test_a_large_result_is_not_kept() -> None:
    calls = []

    @remember
    def large(dt: float) -> tuple[np.ndarray]:
        calls.append(dt)
        return (np.zeros(LARGEST + 1),)

    large(0.01)
    large(0.01)
    assert len(calls) == 2
