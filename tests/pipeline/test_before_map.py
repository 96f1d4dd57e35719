"""What a run says of images without a pose, before there was a map."""

from stillroom.pipeline.summary import before_map


def test_images_before_a_map_and_maps_that_were_dropped_are_said_once_each() -> None:
    refused = {"too little parallax": 9, "two motions explain the pairs": 1}
    said = before_map({"n_before_map": 11, "two_views_refused": refused, "n_maps_dropped": 1, "n_in_dropped_maps": 25})
    assert said == [
        "11 images have no pose: a map could not be begun yet "
        "(pairs of images refused: 9 × too little parallax, 1 × two motions explain the pairs)",
        "1 map was dropped: tracking was lost soon after it began; 25 images were tracked in it, and have no pose",
    ]
    assert before_map({"n_maps_dropped": 2}) == ["2 maps were dropped: tracking was lost soon after it began"]


def test_where_all_images_have_a_pose_nothing_is_said() -> None:
    assert before_map({"n_before_map": 0, "two_views_refused": {}, "n_maps_dropped": 0}) == []
    assert before_map({}) == [], "a results folder of an earlier version"
