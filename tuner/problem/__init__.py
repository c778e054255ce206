"""What is tuned: search space, objective, observations. Imports neither torch nor Optuna."""

from tuner.problem.objective import Objective
from tuner.problem.observations import Observation, Proposal
from tuner.problem.search_space import Parameter, SearchSpace
from tuner.problem.space_files import load_search_space

__all__ = ["Objective", "Observation", "Parameter", "Proposal", "SearchSpace", "load_search_space"]
