"""Planted bugs of LSS (CiA 305): devices that are forgotten, and node-IDs that are not what was told. Tests find them."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

ASSIGN: Final = ("tests/lss/test_lss_assign.py",)
SCAN: Final = ("tests/lss/test_lss_scan.py",)
INTERRUPTED: Final = ("tests/lss/test_lss_interrupted.py",)
RATE: Final = ("tests/lss/test_lss_bit_rate.py",)
COMMANDS: Final = ("tests/cli/test_lss_interrupted.py",)

_ASSIGN: Final = "lss/assign.py"
_SCAN: Final = "lss/scan.py"
_BIT_RATE: Final = "lss/bit_rate.py"
_RATE_COMMAND: Final = "canopen_cli/lss/rate.py"

LSS_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        (
            "nobody_at_first_silence",
            _SCAN,
            "        believed = TRIES * pace.repeats\n",
            "        believed = 1\n",
            "one lost frame, and a device is left behind without a word",
            SCAN,
        ),
        (
            "loss_is_lateness",
            _SCAN,
            "        if failures >= UNLIKELY:\n",
            "        if True:\n",
            "lost frames make every question wait for seconds: eight devices take hours",
            ASSIGN,
        ),
        (
            "search_without_end",
            _SCAN,
            "    if pace.until < NEVER and (yield from current_time()) >= pace.until:\n",
            "    if False:\n",
            "a search has no end",
            ASSIGN,
        ),
        (
            "unfinished_is_silent",
            _ASSIGN,
            "                self.unfinished = str(failed)\n                return None\n",
            "                return None\n",
            "a search that was given up looks like one that found all",
            ASSIGN,
        ),
        (
            "left_alone_hides_others",
            _ASSIGN,
            "            self._aside.append(address)\n        return []\n",
            "        return []\n",
            "a device that is left alone is found again and again, and hides those behind it",
            ASSIGN,
        ),
        (
            "taken_is_free",
            _ASSIGN,
            "                self.taken.add(node_id)\n",
            "",
            "a node-ID that a device may have, since it did not confirm it, is given to another one",
            ASSIGN,
        ),
        (
            "silence_is_stored",
            _ASSIGN,
            "        stored, is_refused = not error, REFUSED in error\n",
            "        stored, is_refused = True, False\n",
            "a device that stores nothing is called ready",
            ASSIGN,
        ),
        (
            "second_device_is_one",
            _ASSIGN,
            "        if unanswered < 0:  # one device",
            "        if reply.count:\n            return reply.answers[0][1]\n        if unanswered < 0:  # one device",
            "two devices with one address get one node-ID",
            ASSIGN,
        ),
        (
            "search_believes_silence",
            _SCAN,
            "            if there:\n                break\n            pace.slow_down(attempt)\n",
            "            break\n",
            "a search through ranges forgets a device because one frame was lost",
            SCAN,
        ),
        (
            "two_confirm_one_node_id",
            _ASSIGN,
            '            return "two answers came, of two devices or of one twice"\n        if reply.count == 1',
            "            pass\n        if reply.count",
            "two devices take one node-ID, and nobody says so",
            ASSIGN,
        ),
        (
            "late_answer_is_a_second_device",
            _ASSIGN,
            "        unanswered += 1 - reply.count\n        if unanswered < 0 and",
            "        if reply.count > 1 and",
            "a user is sent to look for a second device, which is not there",
            ASSIGN,
        ),
        (
            "lost_answer_is_a_one",
            _SCAN,
            "    if pace.repeats == 1:\n        return number",
            "    if True:\n        return number",
            "on a bus that loses frames nearly every number is wrong",
            ASSIGN,
        ),
        (
            "cancelled_stays_selected",
            _SCAN,
            "    except (Cancelled, Exception):\n",
            "    except Exception:\n",
            "after a Ctrl-C a device stays selected: it takes the node-ID of the next one, and no fastscan finds it",
            INTERRUPTED,
        ),
        (
            "interrupted_node_id_stays",
            _ASSIGN,
            "        yield from _take_back(tool, pace, present)\n        raise\n",
            "        raise\n",
            "an interrupted device runs with a node-ID that it has not stored, and the next assignment passes it by",
            INTERRUPTED,
        ),
        (
            "interrupted_bit_rate_stays",
            _BIT_RATE,
            "        yield from take_back(tool, pace, present)\n",
            "        yield from all_waiting(tool)\n",
            "a device keeps a bit rate that nobody else has, once it stores its node-ID: at its next power-on it is gone",
            INTERRUPTED,
        ),
        (
            "take_back_selects_nobody",
            _BIT_RATE,
            "        yield from act(lambda now: tool.master.switch_global(LssState.CONFIGURATION, now))\n        yield from ask",
            "        yield from ask",
            "a device that missed the switch stores the bit rate of which the user was told that nobody has stored it",
            RATE,
        ),
        (
            "missed_switch_stays_pending",
            _RATE_COMMAND,
            "        await lss.run(take_back(lss.tool, lss.pace, change.old))  # those",
            "        pass  # those",
            "a device that missed the switch stores the bit rate of which the user was told that nobody has stored it",
            COMMANDS,
        ),
        (
            "hidden_devices_do_not_count",
            _RATE_COMMAND,
            " or surveyed.again is not None:",
            ":",
            "the bit rate is changed while devices may be hidden: they stay at the old one, and disturb the bus",
            COMMANDS,
        ),
        (
            "lost_bus_after_the_switch_is_silent",
            _RATE_COMMAND,
            "        lost.add_note(change.story)\n",
            "",
            "our interface cannot have the new bit rate, and the user is not told that all devices have it",
            COMMANDS,
        ),
        (
            "interrupted_switch_is_silent",
            _RATE_COMMAND,
            '        change.story = f"the devices may be at',
            '        _ = f"the devices may be at',
            "after a Ctrl-C the user is told that nothing was switched, and all devices are at another bit rate",
            COMMANDS,
        ),
    )
)
