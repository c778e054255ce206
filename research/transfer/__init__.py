"""Study: does what was tuned in one world hold in another? Worlds are conditions and fidelities."""

from research.transfer.study import TransferFindings, TransferSettings, analyse
from research.transfer.worlds import World, worlds

__all__ = ["TransferFindings", "TransferSettings", "World", "analyse", "worlds"]
