"""Maps of answers that nobody knows the truth of."""

from dataclasses import replace

import numpy as np

from testbed.objects.files import load_object
from viz.report.answer_maps import answer_maps
from viz.report.answers import Answer

L2 = load_object("L2")


def test_methods_with_intervals_are_drawn_and_where_none_has_one_it_is_hatched():
    sure = Answer("L2", "own_weight", "hidden_states", "ok", "", L2.shape, L2.truth, 1e-8 * np.eye(6), 1.0, "-", "")
    bare = replace(sure, method="random_search", covariance=None)
    nothing = replace(sure, method="diff_lcp", distribution=None)
    for answers, method, hatched in (
        ([bare, nothing, sure], "hidden_states", 0),
        ([bare, nothing], "random_search", 6),
    ):
        figure = answer_maps(answers)
        labels = [axis.get_ylabel() for axis in figure.axes if axis.get_ylabel()]
        assert labels[0] == f"{method}\nok"
        written = [text.get_text() for axis in figure.axes for text in axis.texts]
        assert written.count("0.400") == 4 and written.count("-") + written.count("not observed") == hatched
