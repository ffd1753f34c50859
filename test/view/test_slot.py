import threading

from softrobot_twin.view.drawing_thread import LatestSlot


def test_the_newest_item_is_taken():
    slot = LatestSlot()
    for item in range(5):
        slot.put(item)
    assert slot.take() == 4
    assert (slot.put_count, slot.taken_count, slot.dropped_count) == (5, 1, 4)


def test_putting_does_not_wait_for_anyone_to_take():
    slot = LatestSlot()
    for item in range(10_000):
        slot.put(item)
    assert slot.dropped_count == 9_999


def test_taking_waits_for_an_item():
    slot = LatestSlot()
    taken = []
    taker = threading.Thread(target=lambda: taken.append(slot.take()))
    taker.start()
    taker.join(0.05)
    assert taken == []
    slot.put("late")
    taker.join(5.0)
    assert taken == ["late"]


def test_a_closed_slot_gives_its_last_item_and_then_nothing():
    slot = LatestSlot()
    slot.put("last")
    slot.close()
    slot.put("too late")
    assert slot.take() == "last"
    assert slot.take() is None
    assert slot.take() is None


def test_closing_wakes_who_waits():
    slot = LatestSlot()
    taken = []
    taker = threading.Thread(target=lambda: taken.append(slot.take()))
    taker.start()
    slot.close()
    taker.join(5.0)
    assert taken == [None]


def test_each_item_is_taken_once_in_order_or_counted_as_dropped():
    slot = LatestSlot()
    taken = []

    def take_all():
        while (item := slot.take()) is not None:
            taken.append(item)

    taker = threading.Thread(target=take_all)
    taker.start()
    for item in range(1, 20_001):
        slot.put(item)
    slot.close()
    taker.join(5.0)
    assert taken == sorted(set(taken))
    assert taken[-1] == 20_000
    assert len(taken) + slot.dropped_count == slot.put_count == 20_000
