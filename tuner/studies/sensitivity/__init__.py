"""Study: on which parameters does the objective depend?"""

from tuner.studies.sensitivity.study import Sensitivity, sensitivity

__all__ = ["Sensitivity", "sensitivity"]
