"""Study: what an oracle that sees the true surface gains, by its notion of coverage."""

from research.oracles.study import OracleFindings, OracleSettings, analyse

__all__ = ["OracleFindings", "OracleSettings", "analyse"]
