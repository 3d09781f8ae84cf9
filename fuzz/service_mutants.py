"""Planted bugs of the services beside SDO: PDO, SYNC, NMT, heartbeat, LSS; and of a server whose host serves an object."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

QUIET: Final = ("tests/core/test_receive_many.py",)
PDO_LIFE: Final = ("tests/core/test_pdo_midlife.py",)
PDO: Final = ("tests/core/test_pdo_machines.py",)
HELD: Final = ("tests/core/test_held_rpdos.py",)
NMT: Final = ("tests/core/test_nmt.py",)
HEARTBEAT: Final = ("tests/core/test_heartbeat.py",)
SYNC: Final = ("tests/core/test_sync.py",)
LSS: Final = ("tests/lss/test_lss.py",)
LSS_LIFE: Final = ("tests/lss/test_lss_midlife.py",)
CHANNELS: Final = ("tests/core/test_sdo_channels.py",)
FAIRNESS: Final = ("tests/core/test_sdo_fairness.py",)
SERVER: Final = ("tests/core/test_sdo_server.py",)
HOST: Final = ("tests/core/test_sdo_server_host.py",)

_PRODUCER: Final = "pdo/producer.py"
_CONSUMER: Final = "pdo/consumer.py"
_SLAVE: Final = "lss/slave.py"
_SDO_CLIENT: Final = "sdo/client.py"
_CONTENTION: Final = "sdo/contention.py"
_QUEUE: Final = "sdo/request_queue.py"
CONTENTION: Final = ("tests/core/test_sdo_contention.py",)
COPIES: Final = ("tests/core/test_sdo_copies.py",)
DEVICE_CODE: Final = ("tests/core/test_declared_device.py",)
RESTORE: Final = ("tests/manager/test_restore.py",)

SERVICE_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        # ---- a quiet network ----
        (
            "deaf_procedure",
            "network.py",
            "return not (self._tasks and self.runner.waits_for_the_usual)",
            "return True",
            "a procedure waits for a PDO that a quiet network does not tell it of",
            QUIET,
        ),
        (
            "deaf_behind_an_event",
            "network.py",
            "root.quiet = self.quiet and not events and self._nobody_waits()\n        bits",
            "root.quiet = self.quiet and self._nobody_waits()\n        bits",
            "a procedure misses the PDO that came before it was told of what it had waited for",
            QUIET,
        ),
        # ---- frames in a burst ----
        (
            "goes_on_over_a_boot",
            "network.py",
            "                    root.timestamp = None\n                    self._before_boot(key, now)\n",
            "                    root.timestamp = None\n",
            "a node is set up half before its boot and half behind it, and that counts as done",
            QUIET,
        ),
        # ---- SDO: frames that come twice ----
        (
            "no_question",
            _QUEUE,
            "return command & _IN_ONE_FRAME == _WRITE and self.may_meet_another(transfer, now, timeout)",
            "return False",
            "a write is confirmed by the second copy of the answer to the one before",
            COPIES,
        ),
        (
            "restore_forgets_a_reset",
            "manager/parameters/restore.py",
            "    if node.boots != boots:\n",
            "    if False:\n",
            "a restore is told as done though the device has booted meanwhile, and lost what was written",
            RESTORE,
        ),
        (
            "restore_believes_a_copy",
            _QUEUE,
            "return command & _IN_ONE_FRAME == _WRITE and self.may_meet_another(transfer, now, timeout)",
            "return False",
            "a restore is told as done though the device has refused its last write of an object",
            RESTORE,
        ),
        (
            "same_question_again",
            _QUEUE,
            "if name != own and name != answered and name not in self.left and name not in self.overdue:",
            "if name != own:",
            "the second copy of the answer to one question answers the next question",
            COPIES,
        ),
        (
            "given_up_is_forgotten",
            _SDO_CLIENT,
            "            self._leave(transfer, now)\n            transfer.abort(AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED)",
            "            transfer.abort(AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED)",
            "a write is confirmed by the answer to one that was cancelled",
            COPIES,
        ),
        (
            "refused_for_another",
            _SDO_CLIENT,
            " and self._asks_again(transfer, data):\n                return",
            ":\n                pass",
            "a read is called refused, though it was the copy of the write before that was refused",
            COPIES,
        ),
        (
            "asks_for_ever",
            _SDO_CLIENT,
            "            transfer.is_answered |= origin is AbortOrigin.PEER\n",
            "",
            "a device that refuses the question is asked again and again",
            COPIES,
        ),
        (
            "halt_behind_a_question",
            _QUEUE,
            "self.answered or transfer.is_urgent or now",
            "self.answered or now",
            "a halt waits for the answer to a question",
            COPIES,
        ),
        # ---- SDO: other clients on the channel ----
        (
            "deaf_to_other_clients",
            _SDO_CLIENT,
            "return (self._hears, RoutingKey(self.can_id | self.flags << 29))",
            "return (self._hears,)",
            "another client's segments are taken for our own answers",
            CONTENTION,
        ),
        (
            "segments_beside_another_client",
            _CONTENTION,
            "if not self.believes or (command & SPECIFIER == INITIATE_UPLOAD_RESPONSE and not command & EXPEDITED_BIT):",
            "if not self.believes:",
            "a read goes on in segments though another client has begun a transfer",
            CONTENTION,
        ),
        (
            "same_object_believed",
            _CONTENTION,
            "transfer.name not in names and ",
            "",
            "a write is confirmed by the answer to another client's write of the same object",
            CONTENTION,
        ),
        (
            "breaks_in",
            _SDO_CLIENT,
            "        elif not queue.urgent:\n            if queue.others:",
            "        elif False:\n            if queue.others:",
            "a request does not wait for the end of another client's exchange",
            CONTENTION,
        ),
        (
            "urgent_waits",
            _SDO_CLIENT,
            "        elif not queue.urgent:\n            if queue.others:",
            "        else:\n            if queue.others:",
            "a halt waits for another client",
            CONTENTION,
        ),
        (
            "stop_to_a_deaf_server",
            _SDO_CLIENT,
            "        elif transfer.is_urgent and self._abandoned is None:",
            "        elif False:",
            "a stop does not reach a server that is deaf in another client's transfer",
            CONTENTION,
        ),
        (
            "any_request_ends_anothers_transfer",
            _SDO_CLIENT,
            "if not abandoned.is_download or (queue.urgent and queue.urgent[0].is_download):",
            "if True:",
            "a request that is no stop ends another client's transfer",
            CONTENTION,
        ),
        (
            "one_limit_for_all_waits",
            _SDO_CLIENT,
            "if self._collided_at > -NEVER or self._contested_since < NEVER:",
            "if self._collided_at > -NEVER:",
            "a drive that is polled is given up in motion, because another client read something 3 s before",
            CONTENTION,
        ),
        (
            "urgent_read_given_up",
            _SDO_CLIENT,
            "            transfer.is_urgent = self._tries < MAX_URGENT_TRIES",
            "            again = again if self._tries < MAX_URGENT_TRIES else None",
            "a motion is given up at once because another client reads the same object",
            CONTENTION,
        ),
        (
            "urgent_success_does_not_count",
            _SDO_CLIENT,
            "        if not transfer.is_urgent or not self._queue.others:",
            "        if not transfer.is_urgent:",
            "a motion whose reads are all urgent is given up 3 s after another client first disturbed one",
            CONTENTION,
        ),
        (
            "contested_write_is_harmless",
            _SDO_CLIENT,
            "AbortOrigin.CONTESTED, transfer.is_download)",
            "AbortOrigin.CONTESTED, False)",
            "a write that another client disturbed is said not to have been executed",
            CONTENTION,
        ),
        (
            "both_writes_mix",
            _SDO_CLIENT,
            "elif transfer.first[0] & (SPECIFIER | EXPEDITED_BIT) != INITIATE_DOWNLOAD | EXPEDITED_BIT:",
            "elif False:",
            "a write that another client's segments meet is not broken off",
            CONTENTION,
        ),
        (
            "left_transfer_stays_open",
            _SDO_CLIENT,
            "        if not transfer.is_download:\n            self._abandoned = transfer\n",
            "        if not transfer.is_download:\n            pass\n",
            "a server that is deaf in a transfer is left in it",
            CONTENTION,
        ),
        (
            "strangers_abort_is_a_refusal",
            _SDO_CLIENT,
            "return (transfer.is_contested and not names_another) or (is_of_protocol and is_ours)",
            "return False",
            "an abort because of another client is told as the server's refusal",
            CONTENTION,
        ),
        (
            "contested_for_ever",
            _SDO_CLIENT,
            "            if now >= limit:\n                while",
            "            if False:\n                while",
            "a request waits for another client without a bound",
            CONTENTION,
        ),
        (
            "acknowledgement_of_another_segment",
            _CONTENTION,
            "is_alike = (request ^ command) & TOGGLE == 0",
            "is_alike = True",
            "another client's exchange counts as over one segment too early",
            CONTENTION,
        ),
        (
            "own_late_answer_confirms",
            _SDO_CLIENT,
            "return is_near and (now < self._queue.may_be_answered_until(name) or name in self.other.unfinished)",
            "return False",
            "an urgent write is confirmed by the late answer to the write before",
            CONTENTION,
        ),
        (
            "believed_beside_its_own",
            _SDO_CLIENT,
            "Contested(transfer, not awaits_other and self.other.leaves_sure(transfer), is_shared)",
            "Contested(transfer, self.other.leaves_sure(transfer), is_shared)",
            "an urgent write is confirmed by the answer to one that was given up, while a stranger reads something else",
            CONTENTION,
        ),
        (
            "counted_confirmations",
            _SDO_CLIENT,
            "            if transfer.is_download:  # it may wait in our queue yet",
            "            if False:  # it may wait in our queue yet",
            "what confirms a stranger's write counts as the late answer to ours, whose own one confirms the next write",
            CONTENTION,
        ),
        (
            "late_refusal_is_sure",
            _SDO_CLIENT,
            "            is_refusal = is_named and not finds_a_copy and not is_late\n",
            "            is_refusal = is_named and not finds_a_copy\n",
            "an urgent write is told as refused by the late refusal of the request before it, and the server executes it",
            CONTENTION,
        ),
        (
            "strangers_refusal_is_ours",
            _CONTENTION,
            "transfer.believes and not transfer.is_shared\n    return is_believed",
            "transfer.believes\n    return is_believed",
            "what refuses a stranger's read is told as the refusal of our write of the same object, which was executed",
            CONTENTION,
        ),
        (
            "refusal_in_doubt_answers",
            _SDO_CLIENT,
            "is_refusal = specifier == ABORT and not transfer.is_shared",
            "is_refusal = specifier == ABORT",
            "a write is confirmed by the answer to the one before, whose refusal was perhaps a stranger's",
            CONTENTION,
        ),
        (
            "own_write_given_up_is_forgotten",
            _CONTENTION,
            "        self._names.add(name)\n        self._written.add(name)\n",
            "        self._names.add(name)\n",
            "a write is confirmed by the answer to one that ended long before, while a stranger goes on",
            CONTENTION,
        ),
        (
            "any_answer_in_doubt_is_ours",
            _SDO_CLIENT,
            "transfer.is_answered = transfer.believes and is_alike",
            "transfer.is_answered = transfer.believes",
            "a late answer to a read counts as that to a write, and what else was given up is forgotten",
            CONTENTION,
        ),
        (
            "one_late_answer_for_all",
            _QUEUE,
            "[*(each for each in before if each > now), until]",
            "[until]",
            "of two urgent writes that timed out the second one's late confirmation confirms the next write",
            CONTENTION,
        ),
        (
            "doubts_for_ever",
            _SDO_CLIENT,
            "return is_near and (now < self._queue.may_be_answered_until(name) or name in self.other.unfinished)",
            "return self._queue.may_be_answered_until(name) > -NEVER or (is_near and name in self.other.unfinished)",
            "after one lost answer no later write of the object is ever confirmed",
            CONTENTION,
        ),
        (
            "size_is_expedited",
            _SDO_CLIENT,
            "elif transfer.first[0] & (SPECIFIER | EXPEDITED_BIT) != INITIATE_DOWNLOAD | EXPEDITED_BIT:",
            "elif not transfer.first[0] & EXPEDITED_BIT:",
            "a server is left in a block write that another client disturbed",
            CONTENTION,
        ),
        (
            "disturbed_backup_is_complete",
            "manager/parameters/backup.py",
            "return not self.others_doing and not any(",
            "return not any(",
            "a backup that met another client counts as complete",
            ("tests/manager/test_backup.py",),
        ),
        # ---- PDO ----
        (
            "trigger_forgets_the_timer",
            _PRODUCER,
            "self._arm(min(self._inhibited_until, self._event_due))",
            "self._arm(self._inhibited_until)",
            "the event timer counts as late where a trigger waits for the end of the inhibit time",
            PDO_LIFE,
        ),
        (
            "timer_ends_with_a_bad_value",
            _PRODUCER,
            "self._event_due = self._inhibited_until  # the timer",
            "self._event_due = NEVER  # the timer",
            "a value that cannot be sent ends an event timer that is shorter than the inhibit time",
            PDO_LIFE,
        ),
        (
            "timer_loses_its_phase",
            _PRODUCER,
            "            self._event_due = due + (skipped + 1) * self.event_time  # the phase is kept\n",
            "",
            "a late event timer begins again at the moment it was served",
            PDO,
        ),
        (
            "old_inhibit_time",
            _PRODUCER,
            "        self._inhibited_until = now\n        timed",
            "        timed",
            "a PDO with other settings waits for the inhibit time of the old ones",
            PDO_LIFE,
        ),
        (
            "old_sample",
            _PRODUCER,
            "        self._sample = None\n        self._triggered = False\n        self._syncs = 0",
            "        self._triggered = False\n        self._syncs = 0",
            "a PDO of type 252 with other settings answers with the values of before",
            PDO_LIFE,
        ),
        (
            "failed_stays_triggered",
            _PRODUCER,
            "        except ValueRangeError as error:\n            self._triggered = False\n",
            "        except ValueRangeError as error:\n",
            "a PDO of type 0 whose value could not be sent goes at a later SYNC, untriggered",
            PDO_LIFE,
        ),
        (
            "long_pdo_unreported",
            _CONSUMER,
            "            self._report_length(len(data), EMCY_PDO_LENGTH_EXCEEDED)\n",
            "            pass\n",
            "a PDO with more bytes than are mapped is no error",
            PDO,
        ),
        (
            "held_over_a_change",
            _CONSUMER,
            "            self._reroute()\n        self._forget()\n",
            "            self._reroute()\n",
            "data that waited for a SYNC act after the PDO was set up otherwise",
            PDO,
        ),
        (
            "heard_sync_is_present",
            _PRODUCER,
            "now - SYNC_TRANSIT if heard else now",
            "now",
            "a SYNC that passed before an RPDO, and was heard late, counts as the one that takes it",
            HELD,
        ),
        # ---- SYNC, NMT, heartbeat ----
        (
            "sync_loses_its_phase",
            "sync.py",
            "            self._arm(due)\n            self.handle_timeout(now)",
            "            self._arm(now)\n            self.handle_timeout(now)",
            "a SYNC that was put off shifts all later ones",
            SYNC,
        ),
        (
            "initialising_listens",
            "nmt.py",
            "            return  # not on the bus\n        data",
            "            pass\n        data",
            "a device that has not booted takes part in the bus",
            NMT,
        ),
        (
            "period_begins_with_each_state",
            "heartbeat.py",
            "        elif previous is NmtState.INITIALISING and self.period:",
            "        elif self.period:",
            "each change of state moves the heartbeat",
            HEARTBEAT,
        ),
        (
            "lost_is_awaited_again",
            "heartbeat.py",
            "        elif self._begun and not self.lost:\n            self._arm(now + timeout)",
            "        elif self._begun:\n            self._arm(now + timeout)",
            "a lost node is lost once more, though nothing was heard of it",
            HEARTBEAT,
        ),
        (
            "back_unnoticed",
            "heartbeat.py",
            "        self.state = None\n        self.usual = _NO_DATA\n",
            "        self.state = None\n",
            "a node that was lost is never told as back",
            HEARTBEAT,
        ),
        (
            "old_state_known",
            "heartbeat.py",
            "        self.last_heard = now\n        self.usual = _NO_DATA\n",
            "        self.last_heard = now\n",
            "a state that is not known any more is told as one that never changed",
            HEARTBEAT,
        ),
        (
            "no_stamp_but_the_first",
            "remote_node.py",
            "told if timestamp is None else HeartbeatReceived",
            "told if timestamp is None or told is not None else HeartbeatReceived",
            "heartbeats lose their time stamps",
            HEARTBEAT,
        ),
        # ---- LSS ----
        (
            "selected_in_any_order",
            _SLAVE,
            "matches = place == 0 or place == self._selected",
            "matches = place == 0 or place >= self._selected",
            "a device is selected by a part of its address",
            LSS,
        ),
        (
            "kept_though_it_failed",
            _SLAVE,
            "        if error == OK:\n            self.persistent = self.pending",
            "        self.persistent = self.pending",
            "what could not be stored counts as stored",
            LSS,
        ),
        (
            "bit_rate_by_reset",
            _SLAVE,
            "self.active = LssConfiguration(self.pending.node_id, self.active.bit_rate)\n        self._enter",
            "self.active = self.pending\n        self._enter",
            "a reset switches the bit rate, which only its activation does",
            LSS_LIFE,
        ),
        (
            "second_delay_of_the_driver",
            _SLAVE,
            "self._arm(self.deadline + self._delay)",
            "self._arm(now + self._delay)",
            "a device whose driver was late is silent for longer than the others",
            LSS,
        ),
        (
            "guard_beyond_the_window",
            "lss/master.py",
            "self._arm(min(self._until, now + self._guard))",
            "self._arm(now + self._guard)",
            "an answer lengthens the time in which further ones are awaited",
            LSS,
        ),
        # ---- a server's host ----
        (
            "piece_in_the_clients_time",
            "sdo/segmented_server.py",
            "            self._door.ask(self)\n            self.deadline = now + end.stream_timeout",
            "            self._door.ask(self)",
            "the host has less time for a further piece than for the first one",
            HOST,
        ),
        # ---- the code of a device ----
        (
            "failed_write_confirmed",
            "local_node.py",
            "            if failure is not None:",
            "            if failure is not None and now < 0:",
            "a client is told that a write was done on which the device has failed to act",
            DEVICE_CODE,
        ),
        # ---- queues and limits ----
        (
            "disabled_channel_goes_on",
            "sdo/channels.py",
            "                self.abort_all(AbortCode.DEVICE_STATE, now)  # `send` keeps it off the bus",
            "                pass",
            "a device that is stopped goes on with its transfers as a client later",
            CHANNELS,
        ),
        (
            "urgent_requests_starve_others",
            "sdo/request_queue.py",
            "        if self._urgent_run == MAX_URGENT_RUN and self.others and",
            "        if self._urgent_run > MAX_URGENT_RUN and self.others and",
            "a caller that is always in a hurry keeps all others waiting",
            FAIRNESS,
        ),
        (
            "host_limit_doubled",
            "sdo/host.py",
            "        if refusal is None and size is not None and size > limit:",
            "        if refusal is None and size is not None and size > 2 * limit:",
            "a value that is too long is not refused before its data come",
            SERVER,
        ),
    )
)
