"""What is sent next and when, on a clock that stands still."""

import math

import pytest

from roadperc_stream.view.live.playhead import (
    EDGE_POLL_S,
    LOOP_PAUSE_S,
    RESUME_LEAD_S,
    TICK_S,
    Move,
    Order,
    Playhead,
    Reach,
    Status,
    decide,
    obey,
)

S = 1_000_000_000
LOG = Reach(100 * S, 200 * S)
GROWING = Reach(100 * S, 150 * S, complete=False)
PLAYING = Playhead(Status.PLAYING, 110 * S, 7 * S)


@pytest.mark.parametrize(("rate", "log_s"), [(1.0, 112), (0.5, 111), (4.0, 118)])
def test_log_time_runs_at_the_rate(rate, log_s):
    assert Playhead(Status.PLAYING, 110 * S, 7 * S, rate).at(9 * S) == log_s * S


@pytest.mark.parametrize("status", [Status.PAUSED, Status.WAITING, Status.ENDED])
def test_log_time_stands_still_otherwise(status):
    assert PLAYING.turned(status, 110 * S, 7 * S).at(99 * S) == 110 * S


def test_a_message_is_sent_when_its_time_has_come():
    assert decide(PLAYING, 111 * S, LOG, 8 * S) == Move(PLAYING, send=True)
    assert decide(PLAYING, 111 * S, LOG, 8 * S - 1).send is False


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
@pytest.mark.parametrize(("ahead", "status"), [(0.99, Status.WAITING), (1.0, Status.PLAYING)])
def test_at_the_edge_playback_goes_on_once_it_can_for_a_while_at_its_rate(rate, ahead, status):
    head = Playhead(Status.WAITING, 150 * S, 9 * S, rate)
    reach = Reach(100 * S, 150 * S + round(ahead * RESUME_LEAD_S * rate * S), complete=False)
    assert decide(head, 150 * S, reach, 20 * S).playhead.status is status


@pytest.mark.parametrize(("rate", "wait_s"), [(1.0, 0.05), (0.5, TICK_S), (2.0, 0.025)])
def test_the_wait_is_the_gap_at_the_rate(rate, wait_s):
    head = Playhead(Status.PLAYING, 110 * S, 7 * S, rate)
    assert decide(head, 110 * S + S // 20, LOG, 7 * S).wait_s == pytest.approx(wait_s)


def test_a_long_gap_is_waited_for_in_ticks():
    assert decide(PLAYING, 190 * S, LOG, 7 * S).wait_s == TICK_S


def test_a_time_that_goes_back_is_due_at_once():
    assert decide(PLAYING, 105 * S, LOG, 7 * S).send


@pytest.mark.parametrize("status", [Status.PAUSED, Status.ENDED])
def test_nothing_is_sent_while_paused_or_ended(status):
    still = PLAYING.turned(status, 110 * S, 7 * S)
    assert decide(still, 105 * S, LOG, 99 * S) == Move(still, wait_s=None)


def test_pause_keeps_the_time_and_play_goes_on_from_it():
    paused, moved = obey(PLAYING, Order(play=False, rate=1.0), LOG, 9 * S)
    assert (paused.status, paused.at(50 * S), moved) == (Status.PAUSED, 112 * S, False)
    resumed, moved = obey(paused, Order(play=True, rate=1.0), LOG, 60 * S)
    assert (resumed.status, resumed.at(61 * S), moved) == (Status.PLAYING, 113 * S, False)


def test_another_speed_while_playing_counts_from_now():
    faster, moved = obey(PLAYING, Order(play=True, rate=3.0), LOG, 9 * S)
    assert (faster.at(9 * S), faster.at(10 * S), moved) == (112 * S, 115 * S, False)


@pytest.mark.parametrize(("asked", "played"), [(3e38, 1000.0), (1000.5, 1000.0), (1e-45, 0.001), (0.5, 0.5)])
def test_a_rate_beyond_what_is_played_becomes_the_nearest_one(asked, played):
    assert obey(PLAYING, Order(play=True, rate=asked), LOG, 9 * S)[0].rate == played


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan, math.inf])
def test_a_rate_that_is_none_changes_nothing(rate):
    assert obey(PLAYING, Order(play=True, rate=rate), LOG, 9 * S)[0].rate == 1.0


@pytest.mark.parametrize(("seek_s", "lands_s"), [(180, 180), (101, 101), (5, 100), (999, 200)])
@pytest.mark.parametrize("play", [True, False])
def test_seeking_both_ways_within_the_log(seek_s, lands_s, play):
    head, moved = obey(PLAYING, Order(play, 1.0, seek_s * S), LOG, 9 * S)
    assert (head.log_ns, moved) == (lands_s * S, True)
    assert head.status is (Status.PLAYING if play else Status.PAUSED)


def test_seeking_beyond_what_is_computed_lands_on_its_edge():
    assert obey(PLAYING, Order(True, 1.0, 180 * S), GROWING, 9 * S)[0].log_ns == 150 * S


def test_the_end_is_the_end():
    ended = decide(PLAYING, None, LOG, 20 * S)
    assert (ended.playhead.status, ended.playhead.log_ns, ended.wait_s) == (Status.ENDED, 200 * S, None)


@pytest.mark.parametrize("status", [Status.ENDED, Status.PAUSED])
def test_playing_from_the_end_starts_over(status):
    head, moved = obey(PLAYING.turned(status, 200 * S, 0), Order(play=True, rate=1.0), LOG, 9 * S)
    assert (head.log_ns, head.status, moved) == (100 * S, Status.PLAYING, True)


def test_a_loop_starts_over_after_a_pause_at_the_end():
    ended = decide(PLAYING, None, LOG, 97 * S, loop_ns=105 * S)
    assert (ended.playhead, ended.wait_s) == (PLAYING.turned(Status.ENDED, 200 * S, 97 * S), LOOP_PAUSE_S)
    early = decide(ended.playhead, None, LOG, 97 * S + S // 10, loop_ns=105 * S)
    assert early == Move(ended.playhead, wait_s=pytest.approx(LOOP_PAUSE_S - 0.1))
    over = decide(ended.playhead, None, LOG, 97 * S + round(LOOP_PAUSE_S * S), loop_ns=105 * S)
    assert (over.restart, over.wait_s) == (True, None)
    assert (over.playhead.status, over.playhead.log_ns) == (Status.PAUSED, 105 * S)


def test_who_paused_at_the_end_stays_there():
    ended = PLAYING.turned(Status.ENDED, 200 * S, 97 * S)
    paused, _ = obey(ended, Order(play=False, rate=1.0), LOG, 97 * S)
    assert decide(paused, None, LOG, 999 * S, loop_ns=105 * S) == Move(paused, wait_s=None)


@pytest.mark.parametrize("loop_ns", [100 * S, None])
def test_a_growing_log_has_no_end_but_an_edge(loop_ns):
    move = decide(PLAYING, None, GROWING, 90 * S, loop_ns=loop_ns)
    assert (move.playhead.status, move.playhead.log_ns, move.wait_s) == (Status.WAITING, 150 * S, EDGE_POLL_S)
    assert not move.restart


@pytest.mark.parametrize(("lead_s", "goes_on"), [(0.1, False), (0.3, True)])
def test_playback_leaves_the_edge_with_a_lead(lead_s, goes_on):
    waiting = PLAYING.turned(Status.WAITING, 150 * S, 9 * S)
    reach = Reach(100 * S, 150 * S + round(lead_s * S), complete=False)
    move = decide(waiting, 150 * S, reach, 20 * S)
    assert (move.playhead.status is Status.PLAYING) is goes_on
    assert move.playhead.at(20 * S) == 150 * S  # the time it waited is not skipped


def test_a_complete_log_is_played_to_its_end_without_a_lead():
    waiting = PLAYING.turned(Status.WAITING, 150 * S, 9 * S)
    assert decide(waiting, 150 * S, Reach(100 * S, 150 * S), 20 * S).playhead.status is Status.PLAYING
