"""Study: does what was tuned in one world hold in another? Worlds are conditions, renderers and fidelities."""

from tuner.studies.transfer.study import TransferFindings, TransferSettings, analyse
from tuner.studies.transfer.worlds import World, worlds

__all__ = ["TransferFindings", "TransferSettings", "World", "analyse", "worlds"]
