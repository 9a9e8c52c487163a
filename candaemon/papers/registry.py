"""Which experiments there are, and which of them a user means."""

from __future__ import annotations

from collections.abc import Sequence

from candaemon.config.settings import unknown_name
from candaemon.errors import ConfigError
from candaemon.papers import automotive_set, avatirak, gao, han, kim_hong, manoeuvre_set, zhang
from candaemon.papers.experiment import Experiment

EXPERIMENTS: tuple[Experiment, ...] = (
    *han.EXPERIMENTS,
    *manoeuvre_set.EXPERIMENTS,
    *automotive_set.EXPERIMENTS,
    *avatirak.EXPERIMENTS,
    *kim_hong.EXPERIMENTS,
    *zhang.EXPERIMENTS,
    *gao.EXPERIMENTS,
)


AUTHORS = {"han": "000", "avatirak": "001", "kim-hong": "002", "zhang": "003", "gao": "004"}
"""Papers by their first authors, as which a user may name them too."""


def choose(names: Sequence[str]) -> tuple[Experiment, ...]:
    """Return the experiments that are meant, each once and in the order of the papers.

    Args:
        names: of experiments, '000-table-1', or of papers, '000' or 'han', which stand for all of theirs; none: all.

    Raises:
        ConfigError: a name is neither; the message lists the known ones and the nearest.
    """
    known = list(dict.fromkeys([each.paper for each in EXPERIMENTS] + [each.name for each in EXPERIMENTS]))
    names = [AUTHORS.get(name, name) for name in names]
    for name in names:
        if name not in known:
            raise ConfigError(unknown_name("experiment", name, known))
    return tuple(each for each in EXPERIMENTS if not names or each.name in names or each.paper in names)
