"""The player on a clock that moves only while it waits, with the log and the viewers scripted."""

from dataclasses import dataclass, field

import pytest

from roadperc_stream.log import Channel, Message
from roadperc_stream.view.live.player import Player
from roadperc_stream.view.live.playhead import LOOP_PAUSE_S, Order, Reach, Status

S = 1_000_000_000
CALIBRATION, IMAGE = Channel("/calibration", "raw"), Channel("/image", "raw")


def message(channel, time_s):
    return Message(channel, round(time_s * S), 0, 0, b"")


WATCH = ["/calibration", "/image"]
STOP = [None]


@dataclass
class Script:
    """A log, those who watch it, and a clock: each wait moves the clock and may bring what is asked."""

    messages: list = field(default_factory=list)
    asked: dict = field(default_factory=dict)
    """Second of the clock: topics and orders that come then; None ends playback."""
    complete_at_s: float = 0.0
    clock_ns: int = 0
    events: list = field(default_factory=list)
    answers: list = field(default_factory=list)
    reads: int = 0
    watching: list = field(default_factory=lambda: list(WATCH))
    """What those who are connected subscribe to when playback starts over."""
    channels = (CALIBRATION, IMAGE)

    def reach(self):
        there = self.there()
        return Reach(0, there[-1].log_time_ns if there else 0, self.clock_ns >= self.complete_at_s * S)

    def there(self):
        """A running replay makes a second of log in two seconds of the clock."""
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
        due_s = min(self.asked)
        until_ns = self.clock_ns + round(wait_s * S)
        if round(due_s * S) > until_ns:
            self.clock_ns = until_ns
            return
        self.clock_ns = max(self.clock_ns, round(due_s * S))
        for asked in self.asked.pop(due_s):
            self.ask(asked)

    def ask(self, asked):
        if isinstance(asked, Order):
            self.answers.append(self.player.control(asked))
        elif asked is None:
            self.player.stop()
        else:
            self.player.watch(asked)

    def set(self):
        """What is asked comes in a wait: nothing to wake."""

    def clear(self):
        """Nothing to forget."""

    def send(self, sent):
        self.events.append((sent.channel.topic, sent.log_time_ns / S, self.clock_ns / S))

    def time(self, log_ns):
        self.told_ns = log_ns

    def state(self, answer):
        self.events.append((answer.playhead.status, answer.playhead.log_ns / S, answer.moved))

    def warn(self, text):
        self.events.append(text)

    def restart(self):
        """All is forgotten; those who watch subscribe again in a tenth of a second."""
        self.events.append("restarted")
        self.asked[self.clock_ns / S + 0.1] = self.watching

    def run(self, start_s=0.0, **options):
        self.player = Player(self, self.now, start_ns=round(start_s * S), asked=self, **options)
        self.player.run(self)
        return self

    def sent(self):
        return [event for event in self.events if event[0] in {"/calibration", "/image"}]


def drive():
    return [message(CALIBRATION, 0), *(message(IMAGE, k) for k in range(5))]


def test_nothing_is_played_to_nobody():
    assert Script(drive(), {9: STOP}).run().sent() == []


@pytest.mark.parametrize("rate", [1.0, 0.5, 2.0])
def test_messages_come_at_their_time_once_somebody_watches(rate):
    script = Script(drive(), {3: WATCH, 30: STOP}).run(rate=rate)
    assert script.sent() == [("/calibration", 0, 3), *(("/image", k, pytest.approx(3 + k / rate)) for k in range(5))]
    assert script.events[-1:] == [(Status.ENDED, 4, False)]


def test_starting_later_shows_what_holds_there():
    script = Script(drive(), {0: WATCH, 9: STOP}).run(start_s=2.5)
    assert [event[:2] for event in script.sent()] == [("/calibration", 0), ("/image", 2), ("/image", 3), ("/image", 4)]


def test_who_comes_late_sees_what_holds_once():
    words = {0: ["/image"], 1.5: ["/calibration"], 9: STOP}
    assert ("/calibration", 0, 1.5) in Script(drive(), words).run().sent()


def test_a_pause_stops_and_play_goes_on():
    pause, play = Order(play=False, rate=1.0), Order(play=True, rate=2.0)
    script = Script(drive(), {0: WATCH, 1.5: [pause], 10: [play], 20: STOP}).run()
    times = [pytest.approx(at) for at in (0, 1, 10.25, 10.75, 11.25)]
    assert [event[2] for event in script.sent() if event[0] == "/image"] == times
    assert script.answers[0].playhead.log_ns == round(1.5 * S)


def test_a_paused_seek_shows_the_whole_frame():
    seek = Order(play=False, rate=1.0, seek_ns=3 * S)
    script = Script(drive(), {0: WATCH, 1.5: [seek], 20: STOP}).run()
    assert script.sent()[-2:] == [("/calibration", 0, 1.5), ("/image", 3, 1.5)]
    assert script.answers[0].moved
    assert script.told_ns == 3 * S


def test_seeking_back_plays_again_from_there():
    words = {0: WATCH, 3.5: [Order(play=True, rate=1.0, seek_ns=1 * S)], 20: STOP}
    images = [event[1] for event in Script(drive(), words).run().sent() if event[0] == "/image"]
    assert images == [0, 1, 2, 3, 1, 2, 3, 4]


def test_a_loop_goes_round():
    """Each round is a session of its own, which begins with what holds at its start."""
    script = Script(drive(), {0: WATCH, 9.8: STOP}).run(loop=True)
    images = [event[1] for event in script.sent() if event[0] == "/image"]
    assert images == [0, 1, 2, 3, 4] * 2 + [0]
    rounds = [i for i, event in enumerate(script.events) if event == "restarted"]
    assert len(rounds) == 2
    for start in rounds:
        assert script.events[start - 1] == (Status.ENDED, 4, False)
        assert script.events[start + 1 : start + 4] == [
            (Status.PAUSED, 0, True),
            ("/calibration", 0, pytest.approx(script.events[start + 2][2])),
            ("/image", 0, pytest.approx(script.events[start + 2][2])),
        ]
        assert script.events[start + 4] == (Status.PLAYING, 0, False)


def test_a_loop_goes_back_to_where_it_started():
    script = Script(drive(), {0: WATCH, 3.9: STOP}).run(start_s=2.0, loop=True)
    assert [event[1] for event in script.sent() if event[0] == "/image"] == [2, 3, 4, 2, 3]


def test_a_loop_that_nobody_watches_any_more_waits():
    script = Script(drive(), {0: WATCH, 99: STOP}, watching=[]).run(loop=True)
    assert [event[1] for event in script.sent() if event[0] == "/image"] == [0, 1, 2, 3, 4]
    assert script.events[-1:] == [(Status.PAUSED, 0, True)]


def test_a_loop_of_one_instant_is_no_race():
    script = Script([message(IMAGE, 0)], {0: ["/image"], 10: STOP}).run(loop=True)
    assert len(script.sent()) <= 10 / LOOP_PAUSE_S


def test_a_running_replay_is_waited_for_and_nothing_is_lost():
    script = Script(drive(), {0: WATCH, 30: STOP}, complete_at_s=9).run()
    assert [event[1] for event in script.sent() if event[0] == "/image"] == [0, 1, 2, 3, 4]
    assert any(event[0] is Status.WAITING for event in script.events)
    assert script.events[-1:] == [(Status.ENDED, 4, False)]


def test_seeking_beyond_what_is_computed_is_told():
    seek = Order(play=True, rate=1.0, seek_ns=4 * S)
    script = Script(drive(), {0: WATCH, 2.5: [seek], 30: STOP}, complete_at_s=9).run()
    assert script.answers[0].playhead.log_ns == 1 * S
    assert any("3.0 s before the time asked for" in event for event in script.events if isinstance(event, str))


def test_an_order_to_a_player_that_ended_is_answered():
    script = Script(drive(), {0: WATCH, 1.5: STOP}).run()
    assert script.player.control(Order(play=False, rate=1.0)).playhead.log_ns == round(1.5 * S)


def test_only_the_newest_waiting_seek_is_carried_out():
    seeks = [Order(play=False, rate=1.0, seek_ns=k * S) for k in (4, 3, 1, 2)]
    once, storm = (Script(drive(), {0: WATCH, 1.5: asked, 9: STOP}).run() for asked in (seeks[-1:], seeks))
    assert [(answer.playhead.log_ns, answer.moved) for answer in storm.answers] == [(s.seek_ns, True) for s in seeks]
    assert (storm.sent(), storm.reads) == (once.sent(), once.reads)


def test_a_seek_that_comes_while_the_next_message_is_read_is_not_lost():
    """The end of what was read before is not the end of playback."""
    script, seek = Script(drive(), {0: WATCH, 20: STOP}), Order(play=True, rate=1.0, seek_ns=3 * S)
    follow = script.follow

    def interrupted(start_ns):
        yield from follow(start_ns)
        script.follow = follow
        script.ask(seek)

    script.follow = interrupted
    assert [event[1] for event in script.run().sent() if event[0] == "/image"] == [0, 1, 2, 3, 4, 3, 4]
    assert script.events[-1] == (Status.ENDED, 4, False)


def test_a_player_never_waits_without_end():
    """A signal that comes just before the wait begins is handled only after it."""
    waits = []
    script = Script(drive(), {9: STOP})
    wait = script.wait
    script.wait = lambda wait_s: (waits.append(wait_s), wait(wait_s))
    script.run()
    assert 0 < max(waits) < 1
