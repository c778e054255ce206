import itertools

from made_evaluations import made_trial

from tuner.comparison.statistics import same_photographs


def records(levels, photographs):
    found = []
    for (name, level), rock, k in itertools.product(levels.items(), ("a", "b", "c"), (0, 1)):
        measured = {"metrics": {"observable": {"f_score_48mm": level + 0.1 * k}}, "costs": {}}
        found.append(made_trial(name, rock, k, photographs=photographs(name, k), measured=measured))
    return found


def test_the_same_photographs_everywhere_are_found_and_once_is_not_enough():
    levels = dict.fromkeys(["covis", "b-aware", "hyb-h"], 90.0)
    everywhere = records(levels, lambda name, k: "one" if name != "covis" else f"covis {k}")
    assert same_photographs(everywhere, [*levels]) == {"hyb-h": "b-aware"}
    once = records(levels, lambda name, k: "one" if k == 0 else name)
    assert same_photographs(once, [*levels]) == {}
