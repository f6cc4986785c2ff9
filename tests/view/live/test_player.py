"""The player with a scripted log, scripted viewers, and a clock that moves only during waits."""

import math
from collections import namedtuple
from dataclasses import dataclass, field

import pytest
from foxglove.websocket import PlaybackCommand
from foxglove.websocket import PlaybackStatus as Status

from roadperc_stream.log import Channel, Message
from roadperc_stream.view.live.player import (
    EDGE_POLL_S,
    LONGEST_WAIT_S,
    LOOP_PAUSE_S,
    RESUME_LEAD_S,
    TICK_S,
    Player,
    Playhead,
    advance,
    apply_request,
)
from roadperc_stream.view.live.source import Reach

S = 1_000_000_000
Request = namedtuple("Request", "playback_command playback_speed seek_time request_id")
Subscribed = namedtuple("Subscribed", "topic")


def request(*, play, rate=1.0, seek_ns=None):
    """A playback request as the SDK passes it."""
    return Request(PlaybackCommand.Play if play else PlaybackCommand.Pause, rate, seek_ns, "id")


CALIBRATION, IMAGE = Channel("/calibration", "raw"), Channel("/image", "raw")


def message(channel, time_s):
    return Message(channel, round(time_s * S), 0, 0, b"")


WATCH = ["/calibration", "/image"]
STOP = [None]


@dataclass
class Script:
    """A log, its viewers and a clock; each wait moves the clock and may deliver requests."""

    messages: list = field(default_factory=list)
    requests: dict = field(default_factory=dict)
    """By second of the clock: subscribed topics and requests; None ends playback."""
    complete_at_s: float = 0.0
    clock_ns: int = 0
    events: list = field(default_factory=list)
    answers: list = field(default_factory=list)
    reads: int = 0
    watching: list = field(default_factory=lambda: list(WATCH))
    """Topics that the viewers subscribe to in a new session."""
    channels = (CALIBRATION, IMAGE)

    def reach(self):
        there = self.there()
        return Reach(0, there[-1].log_time_ns if there else 0, self.clock_ns >= self.complete_at_s * S)

    def there(self):
        """The existing messages; a running replay writes a second of log in two seconds of the clock."""
        if self.clock_ns >= self.complete_at_s * S:
            return self.messages
        return [m for m in self.messages if m.log_time_ns * 2 <= self.clock_ns]

    def read(self, topics, start_ns, end_ns):
        self.reads += 1
        return (m for m in self.there() if m.channel.topic in topics and start_ns <= m.log_time_ns < end_ns)

    def follow(self, start_ns):
        index = next((i for i, m in enumerate(self.messages) if m.log_time_ns >= start_ns), len(self.messages))
        while index < len(self.messages):
            known = index < len(self.there())
            yield self.messages[index] if known else None
            index += known

    def now(self):
        return self.clock_ns

    def wait(self, wait_s):
        due_s = min(self.requests)
        until_ns = self.clock_ns + round(wait_s * S)
        if round(due_s * S) > until_ns:
            self.clock_ns = until_ns
            return
        self.clock_ns = max(self.clock_ns, round(due_s * S))
        for item in self.requests.pop(due_s):
            self.deliver(item)

    def deliver(self, item):
        if isinstance(item, Request):
            self.answers.append(self.player.on_playback_control_request(item))
        elif item is None:
            self.player.stop()
        else:
            self.player.on_subscribe(None, Subscribed(item))

    def set(self):
        """Requests come during waits, so there is nothing to wake."""

    def clear(self):
        """There is nothing to clear."""

    def send(self, sent):
        self.events.append((sent.channel.topic, sent.log_time_ns / S, self.clock_ns / S))

    @property
    def server(self):
        return self

    def broadcast_time(self, log_ns):
        self.sent_time_ns = log_ns

    def broadcast_playback_state(self, state):
        self.events.append((state.status, state.current_time / S, state.did_seek))

    def publish_status(self, text, *_):
        self.events.append(text)

    def restart(self):
        """A new session: the viewers subscribe again after a tenth of a second."""
        self.events.append("restarted")
        self.requests[self.clock_ns / S + 0.1] = self.watching

    def run(self, start_s=0.0, **options):
        self.player = Player(self, self.now, start_ns=round(start_s * S), **options)
        self.player._wake = self
        self.player.run(self)
        return self

    def sent(self):
        return [event for event in self.events if event[0] in ("/calibration", "/image")]


def log():
    return [message(CALIBRATION, 0), *(message(IMAGE, k) for k in range(5))]


def test_without_viewers_nothing_is_played():
    assert Script(log(), {9: STOP}).run().sent() == []


@pytest.mark.parametrize("rate", [1.0, 0.5, 2.0])
def test_messages_are_sent_at_their_time_after_the_first_subscription(rate):
    script = Script(log(), {3: WATCH, 30: STOP}).run(rate=rate)
    assert script.sent() == [("/calibration", 0, 3), *(("/image", k, pytest.approx(3 + k / rate)) for k in range(5))]
    assert script.events[-1:] == [(Status.Ended, 4, False)]


def test_a_later_start_sends_the_held_messages():
    script = Script(log(), {0: WATCH, 9: STOP}).run(start_s=2.5)
    assert [event[:2] for event in script.sent()] == [("/calibration", 0), ("/image", 2), ("/image", 3), ("/image", 4)]


def test_a_late_subscriber_gets_the_held_messages_once():
    words = {0: ["/image"], 1.5: ["/calibration"], 9: STOP}
    assert ("/calibration", 0, 1.5) in Script(log(), words).run().sent()


def test_pause_stops_playback_and_play_continues_it():
    pause, play = request(play=False), request(play=True, rate=2.0)
    script = Script(log(), {0: WATCH, 1.5: [pause], 10: [play], 20: STOP}).run()
    times = [pytest.approx(at) for at in (0, 1, 10.25, 10.75, 11.25)]
    assert [event[2] for event in script.sent() if event[0] == "/image"] == times
    assert script.answers[0].current_time == round(1.5 * S)


def test_a_paused_seek_sends_the_whole_frame():
    seek = request(play=False, seek_ns=3 * S)
    script = Script(log(), {0: WATCH, 1.5: [seek], 20: STOP}).run()
    assert script.sent()[-2:] == [("/calibration", 0, 1.5), ("/image", 3, 1.5)]
    assert script.answers[0].did_seek
    assert script.sent_time_ns == 3 * S


def test_seeking_back_plays_again_from_there():
    words = {0: WATCH, 3.5: [request(play=True, seek_ns=1 * S)], 20: STOP}
    images = [event[1] for event in Script(log(), words).run().sent() if event[0] == "/image"]
    assert images == [0, 1, 2, 3, 1, 2, 3, 4]


def test_each_round_of_a_loop_is_a_new_session():
    """A session starts with the held messages."""
    script = Script(log(), {0: WATCH, 9.8: STOP}).run(loop=True)
    images = [event[1] for event in script.sent() if event[0] == "/image"]
    assert images == [0, 1, 2, 3, 4] * 2 + [0]
    rounds = [i for i, event in enumerate(script.events) if event == "restarted"]
    assert len(rounds) == 2
    for start in rounds:
        assert script.events[start - 1] == (Status.Ended, 4, False)
        assert script.events[start + 1 : start + 4] == [
            (Status.Paused, 0, True),
            ("/calibration", 0, pytest.approx(script.events[start + 2][2])),
            ("/image", 0, pytest.approx(script.events[start + 2][2])),
        ]
        assert script.events[start + 4] == (Status.Playing, 0, False)


def test_a_loop_returns_to_the_start_time():
    script = Script(log(), {0: WATCH, 3.9: STOP}).run(start_s=2.0, loop=True)
    assert [event[1] for event in script.sent() if event[0] == "/image"] == [2, 3, 4, 2, 3]


def test_a_loop_without_viewers_waits():
    script = Script(log(), {0: WATCH, 99: STOP}, watching=[]).run(loop=True)
    assert [event[1] for event in script.sent() if event[0] == "/image"] == [0, 1, 2, 3, 4]
    assert script.events[-1:] == [(Status.Paused, 0, True)]


def test_a_loop_over_one_message_pauses_between_rounds():
    script = Script([message(IMAGE, 0)], {0: ["/image"], 10: STOP}).run(loop=True)
    assert len(script.sent()) <= 10 / LOOP_PAUSE_S


def test_playback_waits_for_a_running_replay_without_loss():
    script = Script(log(), {0: WATCH, 30: STOP}, complete_at_s=9).run()
    assert [event[1] for event in script.sent() if event[0] == "/image"] == [0, 1, 2, 3, 4]
    assert any(event[0] == Status.Buffering for event in script.events)
    assert script.events[-1:] == [(Status.Ended, 4, False)]


def test_a_seek_beyond_the_computed_part_gives_a_warning():
    seek = request(play=True, seek_ns=4 * S)
    script = Script(log(), {0: WATCH, 2.5: [seek], 30: STOP}, complete_at_s=9).run()
    assert script.answers[0].current_time == 1 * S
    assert any("3.0 s before the requested time" in event for event in script.events if isinstance(event, str))


def test_a_stopped_player_answers_requests():
    script = Script(log(), {0: WATCH, 1.5: STOP}).run()
    assert script.player.on_playback_control_request(request(play=False)).current_time == round(1.5 * S)


def test_only_the_newest_waiting_seek_reads_the_log():
    seeks = [request(play=False, seek_ns=k * S) for k in (4, 3, 1, 2)]
    once, storm = (Script(log(), {0: WATCH, 1.5: requests, 9: STOP}).run() for requests in (seeks[-1:], seeks))
    assert [(answer.current_time, answer.did_seek) for answer in storm.answers] == [(s.seek_time, True) for s in seeks]
    assert (storm.sent(), storm.reads) == (once.sent(), once.reads)


def test_a_seek_during_a_read_is_not_lost():
    """The end of the earlier read is not the end of playback."""
    script, seek = Script(log(), {0: WATCH, 20: STOP}), request(play=True, seek_ns=3 * S)
    follow = script.follow

    def interrupted(start_ns):
        yield from follow(start_ns)
        script.follow = follow
        script.deliver(seek)

    script.follow = interrupted
    assert [event[1] for event in script.run().sent() if event[0] == "/image"] == [0, 1, 2, 3, 4, 3, 4]
    assert script.events[-1] == (Status.Ended, 4, False)


def test_every_wait_of_the_player_is_bounded():
    """A signal just before a wait is handled only after it."""
    waits = []
    script = Script(log(), {9: STOP})
    wait = script.wait
    script.wait = lambda wait_s: (waits.append(wait_s), wait(wait_s))
    script.run()
    assert 0 < max(waits) < 1


LOG = Reach(100 * S, 200 * S)
GROWING = Reach(100 * S, 150 * S, complete=False)
PLAYING = Playhead(Status.Playing, 110 * S, 7 * S)


@pytest.mark.parametrize(
    ("rate", "next_s", "wait_s"), [(1, 110.05, 0.05), (2, 110.05, 0.025), (1, 190, TICK_S), (1, 105, 0)]
)
def test_the_wait_is_the_time_to_the_next_message_and_one_tick_at_most(rate, next_s, wait_s):
    head = Playhead(Status.Playing, 110 * S, 7 * S, rate)
    assert advance(head, round(next_s * S), LOG, 7 * S) == (head, pytest.approx(wait_s))


def test_a_new_rate_applies_from_now_on():
    faster, moved = apply_request(PLAYING, request(play=True, rate=3.0), LOG, 9 * S)
    assert (faster.at(9 * S), faster.at(10 * S), moved) == (112 * S, 115 * S, False)


def test_rates_are_clamped_and_invalid_ones_ignored():
    head, invalid = Playhead(Status.Playing, 110 * S, 7 * S, 2.0), (0.0, -1.0, math.nan, math.inf)
    for rate, played in ((3e38, 1000.0), (1000.5, 1000.0), (1e-45, 0.001), (0.5, 0.5), *((r, 2.0) for r in invalid)):
        assert apply_request(head, request(play=True, rate=rate), LOG, 9 * S)[0].rate == played


@pytest.mark.parametrize(("seek_s", "lands_s"), [(180, 180), (101, 101), (5, 100), (999, 200)])
def test_a_seek_is_clamped_to_the_log(seek_s, lands_s):
    for play, status in ((True, Status.Playing), (False, Status.Paused)):
        head, moved = apply_request(PLAYING, request(play=play, seek_ns=seek_s * S), LOG, 9 * S)
        assert (head.log_ns, head.status, moved) == (lands_s * S, status, True)


def test_a_gap_of_more_than_an_hour_is_skipped():
    next_ns = 110 * S + 3600 * S + 1
    head, wait_s = advance(PLAYING, next_ns, Reach(100 * S, 2 * next_ns), 7 * S)
    assert (head.log_ns, head.at(7 * S), wait_s) == (next_ns, next_ns, 0)


@pytest.mark.parametrize("status", [Status.Ended, Status.Paused])
def test_playing_from_the_end_starts_over(status):
    head, moved = apply_request(Playhead(status, 200 * S, 0), request(play=True), LOG, 9 * S)
    assert (head.log_ns, head.status, moved) == (100 * S, Status.Playing, True)


def test_a_pause_at_the_end_does_not_loop():
    paused, _ = apply_request(Playhead(Status.Ended, 200 * S, 97 * S), request(play=False), LOG, 97 * S)
    assert advance(paused, None, LOG, 999 * S, loop_ns=105 * S) == (paused, LONGEST_WAIT_S)


@pytest.mark.parametrize("loop_ns", [100 * S, None])
def test_the_end_of_a_growing_log_means_buffering(loop_ns):
    edge = Playhead(Status.Buffering, 150 * S, 90 * S)
    assert advance(PLAYING, None, GROWING, 90 * S, loop_ns=loop_ns) == (edge, EDGE_POLL_S)


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
@pytest.mark.parametrize(("ahead", "complete", "goes_on"), [(0.99, False, False), (1.0, False, True), (0, True, True)])
def test_buffering_ends_with_enough_lead_or_a_complete_log(rate, ahead, complete, goes_on):
    head = Playhead(Status.Buffering, 150 * S, 9 * S, rate)
    reach = Reach(100 * S, 150 * S + round(ahead * RESUME_LEAD_S * rate * S), complete)
    after, _ = advance(head, 150 * S, reach, 20 * S)
    assert (after.status == Status.Playing) is goes_on
    assert after.at(20 * S) == 150 * S  # playback skips nothing
