"""Background calls of a training: the same in another process and in this one."""

import os
import signal
import time

import pytest
import torch
from torch import nn

from geort_drake.errors import TrainingError
from geort_drake.retargeting.training.background import BackgroundProcess, result_of

ENDED = "background process of the training ended"


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


@pytest.mark.parametrize("separate", [True, False])
def test_calls_keep_their_state_and_see_the_network_of_their_start(separate):
    """An error of one call reaches the caller and leaves the others alone."""
    network = nn.Linear(1, 1)
    calls = []
    with BackgroundProcess({"sum": Summed(), "refuse": refuse}, separate) as background:
        for value in (1.0, 2.0, 3.0):
            network.weight.data.fill_(value)
            calls.append(background.start("sum", network, 10.0))
        network.weight.data.fill_(100.0)
        with pytest.raises(ValueError, match="not this one"):
            result_of(background.start("refuse", network))
        assert [float(result_of(call)[1]) for call in calls] == [10.0, 30.0, 60.0]
        number = result_of(calls[0])[0]
    assert (number != os.getpid()) == separate
    while separate:  # the process ends with the training
        try:
            os.kill(number, 0)
        except ProcessLookupError:
            break
        time.sleep(0.05)


def test_a_process_that_dies_is_reported():
    """During a call, and at the next one; nobody waits for it for ever."""
    network = nn.Linear(1, 1)
    with BackgroundProcess({"die": die}, separate=True) as background:
        with pytest.raises(TrainingError, match=ENDED):
            result_of(background.start("die", network))
        with pytest.raises(TrainingError, match=ENDED):
            background.start("die", network)
