"""Study: does the objective tell configurations apart?"""

from tuner.studies.noise.study import NoiseFindings, NoiseSettings, analyse

__all__ = ["NoiseFindings", "NoiseSettings", "analyse"]
