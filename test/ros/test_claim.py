"""What a neighbour claims is read like any other message: what no twin can have written is no claim."""

import json
from types import SimpleNamespace

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from softrobot_twin.ros.claim import MOST_RIVALS, Beat, TopicClaim

IDENTITY = "0123456789abcdef" * 2
NAME = "/twin (process 12 on laboratory)"


def claim(identity=IDENTITY, name=NAME, age="1.5", is_enabled="true"):
    """The text of a claim."""
    return f"[{json.dumps(identity)}, {json.dumps(name)}, {age}, {is_enabled}]"


def test_the_claim_of_a_twin_is_read():
    beat = Beat(IDENTITY, NAME, 1.5, True)
    assert Beat.of(claim()) == beat == Beat.of(json.dumps(beat))


@pytest.mark.parametrize("text", (
    *(claim(age=age) for age in (
        "1e400", "-1e400", "1" + "0" * 400, "1" + "0" * 5000, "NaN", "-1", "1e300", '"old"', "null",
        "[]")),
    *(claim(name=name) for name in (
        "liar\n[ERROR] [1.0] [twin]: burns", "\x1b[31mred", "a\rb", "a\0b", "\ud800", "\u202eabc",
        "x" * 501, 7, None, ["/twin"])),
    *(claim(identity=identity) for identity in ("liar", "", 1, None, IDENTITY.upper(), IDENTITY + "\n")),
    *(claim(is_enabled=enabled) for enabled in ("1", '"yes"', "null", "[]")),
    "", "{}", "null", "[1, 2]", "[" * 900, '{"a": 1, "b": 2, "c": 3, "d": 4}', "\0" * 100,
))  # fmt: skip
def test_what_no_twin_can_have_written_is_no_claim(text):
    assert Beat.of(text) is None


class Neighbourhood:
    """As much of a node as a claim needs; another one publishes commands or not."""

    publishers = ("/twin",)
    create_publisher = create_subscription = staticmethod(lambda *arguments, **options: None)

    def get_fully_qualified_name(self):
        return "/twin"

    def get_publishers_info_by_topic(self, topic):
        return [SimpleNamespace(node_namespace=name.rpartition("/")[0] or "/",
                                node_name=name.rpartition("/")[2]) for name in self.publishers]


@pytest.fixture
def heard(monkeypatch):
    """A claim that hears texts, without a network."""
    monkeypatch.setattr("softrobot_twin.ros.claim.Node", Neighbourhood)
    node = Neighbourhood()
    made = TopicClaim(node, "/twin/cables")
    made.close()
    made.node, made.say = node, lambda text: made.hear(serialize_message(String(data=text)))
    return made


def test_a_claim_without_a_publisher_of_commands_stops_nobody(heard):
    heard.say(claim(age="1e8"))
    assert len(heard.rivals) == 1 and heard.is_alone and not heard.why_not()
    heard.node.publishers = "/twin", "/lab/device"
    assert heard.is_alone
    heard.node.publishers = "/twin", "/lab/device", "/twin"
    assert not heard.is_alone
    assert heard.why_not() == f"/twin/cables is commanded by {NAME}: end one of both"
    heard.say(claim(name="/lab/device (process 1 on another)", age="1e9"))
    assert heard.why_not() == "/twin/cables is commanded by /lab/device (process 1 on another): end one of both"


def test_a_flood_of_claims_takes_no_memory_and_hides_no_twin_that_was_heard(heard):
    heard.say(claim())
    for number in range(1000):
        heard.say(claim(identity=f"{number:032x}"))
    assert len(heard.rivals) == MOST_RIVALS and IDENTITY in heard.rivals
    heard.say(claim(age="7"))
    assert heard.rivals[IDENTITY].heard - heard.rivals[IDENTITY].began == pytest.approx(7.0)


@pytest.mark.parametrize("content", (b"", b"\0", b"\0\1\0\0\xff\xff\xff\xff", b"\xff" * 40))
def test_what_is_no_message_at_all_is_no_claim(heard, content):
    heard.hear(content)
    assert not heard.rivals
