"""What is asked beside a descent: the same in a process and here."""

import os
import signal
import time

import pytest
import torch
from torch import nn

from geort_drake.errors import TrainingError
from geort_drake.retargeting.training.background import Beside, result_of


class Summed:
    """A function with a state: the sum of the weights of all networks that it was called with."""

    def __init__(self):
        self.sum = torch.zeros(())

    def __call__(self, network: nn.Module, factor: float) -> tuple[int, torch.Tensor]:
        self.sum = self.sum + factor * network.weight.detach().sum()
        return os.getpid(), self.sum


def refuse(network: nn.Module) -> None:
    raise ValueError("not this one")


def die(network: nn.Module) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture(params=[True, False], ids=["process", "here"])
def beside(request):
    with Beside({"sum": Summed(), "refuse": refuse}, process=request.param) as beside:
        yield beside


def test_calls_follow_each_other_and_keep_their_state(beside):
    """Each is about the network as it was when the call was begun."""
    network = nn.Linear(1, 1)
    calls = []
    for value in (1.0, 2.0, 3.0):
        network.weight.data.fill_(value)
        calls.append(beside.start("sum", network, 10.0))
    network.weight.data.fill_(100.0)
    assert [float(result_of(call)[1]) for call in calls] == [10.0, 30.0, 60.0]


def test_an_error_reaches_who_waits_for_the_result(beside):
    """As it was raised; other calls are not affected."""
    network = nn.Linear(1, 1)
    with pytest.raises(ValueError, match="not this one"):
        result_of(beside.start("refuse", network))
    assert float(result_of(beside.start("sum", network, 0.0))[1]) == 0.0


def test_a_process_ends_with_its_descent():
    """It does not stay behind, holding its memory."""
    with Beside({"sum": Summed()}, process=True) as beside:
        number, _ = result_of(beside.start("sum", nn.Linear(1, 1), 1.0))
        assert number != os.getpid()
    for _ in range(100):
        try:
            os.kill(number, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("the process is still there")


ENDED = "prepares the batches of training ended"


def test_a_process_that_ends_during_a_call_is_named():
    """Nobody waits for it for ever, and the next call says so too."""
    network = nn.Linear(1, 1)
    with Beside({"die": die}, process=True) as beside:
        with pytest.raises(TrainingError, match=ENDED):
            result_of(beside.start("die", network))
        with pytest.raises(TrainingError, match=ENDED):
            beside.start("die", network)


def test_a_process_that_ends_between_calls_is_named():
    """By the next call, when it begins or when its result is asked for."""
    network = nn.Linear(1, 1)
    with Beside({"sum": Summed()}, process=True) as beside:
        number, _ = result_of(beside.start("sum", network, 1.0))
        os.kill(number, signal.SIGKILL)
        with pytest.raises(TrainingError, match=ENDED):
            for _ in range(100):
                result_of(beside.start("sum", network, 1.0))
                time.sleep(0.1)
