"""Planted bugs of the gateways: holes in the guard, a lease without an end, answers of other requests. Tests find them."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

VALUES: Final = ("tests/gateway/test_gateway_values.py",)
TEXT: Final = ("tests/gateway/test_gateway_text.py",)
CLIENT: Final = ("tests/gateway/test_gateway_client.py",)
EARS: Final = ("tests/gateway/test_gateway_ears.py",)
GUARD: Final = ("tests/gateway/test_gateway_guard.py",)
SERVICE: Final = ("tests/gateway/test_gateway_service.py",)
LEASE: Final = ("tests/gateway/test_lease.py",)
COMMISSION: Final = ("tests/gateway/test_web_commission.py",)
COMMANDS: Final = ("tests/gateway/test_ascii_commands.py",)
LSS: Final = ("tests/gateway/test_ascii_lss.py",)
DOOR: Final = ("tests/gateway/test_ascii_door.py",)
NETS: Final = ("tests/gateway/test_several_nets.py",)
FLEET: Final = ("tests/gateway/test_fleet.py",)
FLEET_WEB: Final = ("tests/gateway/test_fleet_web.py",)
PICTURE: Final = ("tests/gateway/test_fleet_picture.py",)
LEAD: Final = ("tests/gateway/test_fleet_lead.py",)
WEB: Final = ("tests/gateway/test_web_guard.py",)
TRAFFIC: Final = ("tests/gateway/test_traffic.py",)
LIVE: Final = ("tests/gateway/test_web_live.py",)
TUI: Final = ("tests/cli/test_tui.py",)

_GUARD: Final = "canopen_gateway/guard.py"
_LEASE: Final = "canopen_gateway/lease.py"
_SERVICE: Final = "canopen_gateway/service.py"
_DOOR: Final = "canopen_gateway/ascii/door.py"
_WEB: Final = "canopen_gateway/web/guard.py"
_LIVE: Final = "canopen_gateway/web/live.py"
_CONNECTION: Final = "canopen_gateway/ascii/connection.py"
_FLEET: Final = "canopen_gateway/fleet"
_SUBJECT: Final = "canopen_gateway/web/fleet_subject.py"
_PICTURE: Final = "canopen_gateway/web/fleet_picture.py"

GATEWAY_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        (
            "any_answer_of_the_tui_is_yes",
            "canopen_cli/tui/app.py",
            "if answer == YES:",
            "if answer is not None:",
            "in the terminal view, Enter at the second question writes, and so do keys that a cat presses",
            TUI,
        ),
        (
            "anybody_resets_what_moves",
            _LEASE,
            "if node in powered or self._has_power(node):",
            "if False:",
            "an NMT stop or a reset of anybody takes the commands from a drive with power, and a hanging axis falls",
            LEASE,
        ),
        (
            "anybody_resets_what_gets_power",
            _LEASE,
            "(arm.devices if self.doing else _led(arm))",
            "_led(arm)",
            "a reset meets a drive while the owner of the lease gives it power",
            LEASE,
        ),
        (
            "a_lease_that_is_over_resets",
            _LEASE,
            "        if self.owner is session and self.left > 0.0:\n            return []\n",
            "        if self.owner in (session, None):\n            return []\n",
            "without an owner, everybody may take the commands from a drive with power",
            LEASE,
        ),
        (
            "reset_by_a_write",
            _SERVICE,
            "elif permission is Permission.PROGRAM:",
            "elif permission is Permission.STORE:",
            "a write of 0x1F51 starts a device anew whose drive has power",
            LEASE,
        ),
        (
            "lease_free_while_it_brakes",
            _LEASE,
            "        await self._ended.wait()\n",
            "",
            "somebody else takes the lease while the drive that was commissioned still brakes",
            COMMISSION,
        ),
        (
            "power_away_while_it_brakes",
            "canopen_master/motion/single_drive.py",
            "            if axis.occupancy.stops:  # that of somebody else: it may brake yet\n",
            "            if False:\n",
            "a halt by hand of a drive that is commissioned takes its power away at speed",
            COMMISSION,
        ),
        (
            "trace_in_one_turn",
            "canopen_gateway/traffic/trace.py",
            "            first = slice_end\n            await trio.lowlevel.checkpoint()\n",
            "            first = slice_end\n",
            "a trace of a full ring holds up a cycle for 4 ms",
            TRAFFIC,
        ),
        (
            "trace_with_frames_of_later",
            "canopen_gateway/traffic/trace.py",
            "            lost = min(end, max(first, ring.first)) - first\n",
            "            lost = 0\n",
            "frames that came while a trace was copied stand in it as older ones, and nothing tells what is missing",
            TRAFFIC,
        ),
        (
            "any_host_is_ours",
            _WEB,
            "        if len(host) != 1 or host[0].lower() not in self.hosts:\n",
            "        if len(host) != 1:\n",
            "a page whose name means 127.0.0.1 (DNS rebinding) reads the machine",
            WEB,
        ),
        (
            "origin_null_is_ours",
            _WEB,
            "        if any(origin.lower() not in self._origins for origin in origins):\n",
            '        if any(origin.lower() not in (*self._origins, "null") for origin in origins):\n',
            "a sandboxed frame of any page speaks to the door",
            WEB,
        ),
        (
            "cookie_alone_changes",
            _WEB,
            '        if method not in SAFE_METHODS and headers.get("x-canopen") != ["1"]:\n',
            '        if method == "PUT" and headers.get("x-canopen") != ["1"]:\n',
            "a form of a foreign page gives commands by POST",
            WEB,
        ),
        (
            "websocket_needs_no_origin",
            _WEB,
            "            return None if origins else WebRefusal(403,",
            "            return None if True else WebRefusal(403,",
            "a WebSocket from anywhere that has the cookie moves the machine",
            (*WEB, *LIVE),
        ),
        (
            "any_token_will_do",
            _WEB,
            "        return len(given) == 1 and secrets.compare_digest(_digest(given[0]), self._token)\n",
            "        return len(given) == 1\n",
            "every cookie of that name opens the door",
            WEB,
        ),
        (
            "body_without_bound",
            _WEB,
            "                if len(body) > MAX_BODY:\n",
            "                if len(body) > 1000 * MAX_BODY:\n",
            "a body without a length fills the memory",
            WEB,
        ),
        (
            "hung_page_kept",
            _LIVE,
            "            if limit.cancelled_caught:\n",
            "            if False:\n",
            "a page that hangs keeps its place for ever",
            LIVE,
        ),
        (
            "page_without_lease_of_its_own",
            _LIVE,
            '            case "renew":\n                lease.renew(session, _sequence(message))\n',
            '            case "renew":\n                lease.renew(lease.owner or session, _sequence(message))\n',
            "another page keeps a lease alive whose owner is gone",
            LIVE,
        ),
        (
            "further_axis_unguarded",
            _GUARD,
            "    if axis is not None and index_of(swapped(mux(index, subindex), axis)) in _MOTION:\n",
            "    if axis is not None and index in _MOTION:\n",
            "the controlword of a second axis counts as a setting",
            GUARD,
        ),
        (
            "rpdo_mapping_is_a_setting",
            _GUARD,
            "    (indices.RPDO_MAPPINGS, Permission.MOTION),\n",
            "",
            "a client without motion maps a controlword into an RPDO that somebody sends",
            GUARD,
        ),
        (
            "store_range_short_by_one",
            _GUARD,
            "range(indices.STORE_PARAMETERS, indices.RESTORE_DEFAULT_PARAMETERS + 1)",
            "range(indices.STORE_PARAMETERS, indices.RESTORE_DEFAULT_PARAMETERS)",
            "the defaults of a device may be restored by whoever may write settings",
            GUARD,
        ),
        (
            "any_permission_will_do",
            _GUARD,
            "        if permission not in self.allowed:\n",
            "        if not self.allowed:\n",
            "--allow nmt allows everything",
            GUARD,
        ),
        (
            "write_without_asking",
            _SERVICE,
            "        self.service.guard.require_write(index, subindex)\n",
            "",
            "a read-only gateway writes",
            (*SERVICE, *COMMANDS),
        ),
        (
            "pdo_without_asking",
            _SERVICE,
            '        self.service.guard.require(Permission.MOTION, "sending a PDO")\n',
            "",
            "a PDO that carries a controlword leaves a read-only gateway",
            SERVICE,
        ),
        (
            "write_beside_the_lease",
            _SERVICE,
            "                self.service.lease.require_free(self, what)\n",
            "",
            "a client writes the controlword of a drive that another one moves",
            LEASE,
        ),
        (
            "impatience_reaches_the_chain",
            _SERVICE,
            "            patience = None if self.service.is_moved(node) else timeout\n            return",
            "            patience = timeout\n            return",
            "a client that waits a millisecond only stops the chain whose joint it asks",
            SERVICE,
        ),
        (
            "time_out_stays",
            _SERVICE,
            "            return await node.read_bytes(index, subindex, block=block, patience=patience)\n",
            (
                "            node.remote.sdo.timeout = round((patience or 0.5) * 1e9)\n"
                "            return await node.read_bytes(index, subindex, block=block)\n"
            ),
            "the time-out of one client counts for all who come after it",
            COMMANDS,
        ),
        (
            "impatience_reaches_a_halt",
            _SERVICE,
            "            return await node.read_bytes(index, subindex, block=block, patience=patience)\n",
            (
                "            before, client = node.remote.sdo.timeout, node.remote.sdo\n"
                "            client.timeout = before if patience is None else round(patience * 1e9)\n"
                "            try:\n"
                "                return await node.read_bytes(index, subindex, block=block)\n"
                "            finally:\n"
                "                client.timeout = before\n"
            ),
            "while a client that only reads waits a millisecond for a drive, nobody's halt of that drive is confirmed",
            LEASE,
        ),
        (
            "ears_left_behind",
            _SERVICE,
            "        for net, ear in self._ears.items():\n            self.service.detach(net, ear)\n",
            "",
            "each connection leaves a machine on the bus: memory, and time for each frame",
            SERVICE,
        ),
        (
            "lease_without_end",
            _LEASE,
            "        while trio.current_time() < self._deadline:\n            with",
            "        while True:\n            with",
            "a client that hangs keeps the machine for ever",
            LEASE,
        ),
        (
            "over_and_not_halted",
            _LEASE,
            "start_soon(self._halted, name, chain.halt, problems)\n                for node",
            "start_soon(trio.lowlevel.checkpoint)\n                for node",
            "the lease is over, and the drives stay at their last set-point, ready for the next",
            LEASE,
        ),
        (
            "renewed_by_an_old_message",
            _LEASE,
            "        if sequence <= self._last:\n",
            "        if sequence < self._last:\n",
            "a message that comes twice moves the machine twice",
            LEASE,
        ),
        (
            "refused_jog_counts",
            _LEASE,
            "        self.renew(session, sequence)\n        self._require_power(chain)\n        self._wanted = list(",
            "        self._wanted = list(velocities)\n        self.renew(session, sequence)\n        list(",
            "velocities of a client that is refused move the machine if they come while a jog begins",
            LEASE,
        ),
        (
            "jog_without_its_own_switch",
            _LEASE,
            "        async with arm.jog(renew_within=LEASE_TIME) as jog:\n",
            "        async with arm.jog(renew_within=3600.0) as jog:\n",
            "signs of life alone keep a jog going",
            LEASE,
        ),
        (
            "halt_needs_permission",
            _LEASE,
            "        self.stop_motion()\n        chains = [",
            '        self._guard.require(Permission.MOTION, "halt")\n        chains = [',
            "nobody may halt at a read-only gateway",
            LEASE,
        ),
        (
            "gone_and_not_halted",
            _LEASE,
            "            self._waiting.cancel()\n",
            "",
            "a client that left moves the machine until its lease is over",
            LEASE,
        ),
        (
            "answer_of_another_request",
            "gateway/client.py",
            "        if isinstance(message, GatewayAnswer) and message.sequence in self._open:\n",
            (
                "        if isinstance(message, GatewayAnswer) and self._open:\n"
                "            message = replace(message, sequence=min(self._open))\n"
            ),
            "a late answer is taken for that of the next request",
            CLIENT,
        ),
        (
            "longest_line_refused",
            "gateway/lines.py",
            "            if end - begin > self._limit:\n",
            "            if end - begin >= self._limit:\n",
            "a line of exactly the allowed length ends its connection",
            TEXT,
        ),
        (
            "page_commands",
            _DOOR,
            "                if _HTTP.search(line):\n",
            "                if False:\n",
            "a page in a browser moves the machine of the computer that shows it",
            DOOR,
        ),
        (
            "halt_needs_a_net",
            _CONNECTION,
            "        if request.net is not None or (request.node and self._net is not None):\n",
            "        if request.net is not None or request.node:\n",
            "a halt without a net is refused where there are two",
            NETS,
        ),
        (
            "line_without_bound",
            "gateway/lines.py",
            "        if len(self._pending) > self._limit + len(self._line_end) - 1:",
            "        if len(self._pending) > self._limit << 20:",
            "a client that never ends its line fills the memory",
            (*TEXT, *DOOR),
        ),
        (
            "leading_zero_is_decimal",
            "gateway/value_types.py",
            "(0|[1-9][0-9]{0,24}))",
            "([0-9]{1,25}))",
            "010 is 10 here and 8 for every C program: another value is written",
            VALUES,
        ),
        (
            "quote_not_doubled",
            "gateway/value_types.py",
            """    return '"{}"'.format(shown.replace('"', '""'))\n""",
            """    return f'"{shown}"'\n""",
            "a quote in a device's name ends the value",
            VALUES,
        ),
        (
            "lost_again_and_again",
            "gateway/node_ear.py",
            "                watched.deadline, watched.state = NEVER, None\n",
            "                watched.state = None\n",
            "a node that is lost is reported without end",
            EARS,
        ),
        (
            "pdo_as_sync",
            "gateway/pdo_port.py",
            "        if is_refused or (not listens and key <= _LAST_OF_SERVICES):\n",
            "        if is_refused:\n",
            "a PDO of a gateway may be a SYNC, and let all set-points act",
            EARS,
        ),
        (
            "default_node_halts_alone",
            _CONNECTION,
            "        net = None\n        if request.net is not None or (request.node and self._net is not None):\n",
            "        net = self._nets[0]\n        if request.net is not None or (request.node and self._net is not None):\n",
            "halt all halts one net",
            ("tests/gateway/test_several_nets.py",),
        ),
        (
            "question_to_nobody",
            _CONNECTION,
            "        if selected and not settings.is_selected:\n",
            "        if False:\n",
            "whoever is selected by another master gets the node-ID",
            LSS,
        ),
        (
            "all_interfaces",
            _DOOR,
            "    if not reachable and not is_loopback(host):\n",
            "    if False:\n",
            "a door without a password is open to the network",
            DOOR,
        ),
        (
            "silent_clients_keep_all_places",
            _DOOR,
            "        silent.scope.cancel()\n        await silent.gone.wait()\n",
            "        return\n",
            "sixteen connections that say nothing lock everybody out",
            DOOR,
        ),
        (
            "one_fails_all_fail",
            _DOOR,
            '        except* Exception:\n            LOGGER.exception("the connection of %s failed", client.name)\n',
            "        except* KeyError:\n            pass\n",
            "a mistake in one connection ends the door, and the master with it",
            DOOR,
        ),
        (
            "halted_moves_on",
            _LEASE,
            "        self._halted_by_hand |= names\n",
            "",
            "the owner's next message moves what somebody has halted",
            LEASE,
        ),
        (
            "halt_leaves_the_lease",
            _LEASE,
            "            self._over = BY_HAND\n            self.leave(self.owner)\n",
            "            self._over = BY_HAND\n",
            "who was halted has the machine still",
            LEASE,
        ),
        (
            "tpdo_is_a_setting",
            _GUARD,
            "    (range(0x1800, 0x1C00), Permission.MOTION),  # TPDOs\n",
            "",
            "a client without motion lets a device send under the COB-ID of a set-point",
            GUARD,
        ),
        (
            "fleet_halt_waits",
            f"{_FLEET}/bridge.py",
            "        if found is not None and found[1][0] in URGENT:",
            "        if found is not None and found[1][0] in ():",
            "a halt is refused, since somebody reads much",
            FLEET,
        ),
        (
            "fleet_writes_to_all",
            f"{_FLEET}/bridge.py",
            "            if rest[0] in ONE_PLACE and (",
            "            if rest[0] in () and (",
            "one query of anybody writes to each node",
            FLEET,
        ),
        (
            "fleet_stranger_keeps_the_lease",
            f"{_FLEET}/leading.py",
            "holder.proof != proof or ",
            "",
            "whoever speaks has the lease that another one took",
            LEAD,
        ),
        (
            "fleet_query_by_two_ways",
            f"{_FLEET}/bridge.py",
            "        if mark in self._asked:\n            return True\n",
            "",
            "by two routers a write, a command and an intent are carried out twice",
            FLEET,
        ),
        (
            "fleet_message_of_an_earlier_lease",
            f"{_FLEET}/leading.py",
            """ and said.get("term") != holder.term""",
            " and False",
            "a jog that was recorded, or came late, moves the machine when its client has the lease again",
            LEAD,
        ),
        (
            "fleet_numbers_unlooked_at",
            f"{_FLEET}/leading.py",
            "                lease.renew(holder, sequence)\n",
            "                lease.renew(holder, lease._last + 1)\n",
            "a message that was sent again renews the lease",
            LEAD,
        ),
        (
            "fleet_nan_is_a_number",
            f"{_FLEET}/leading.py",
            " and abs(value) <= MOST",
            "",
            "a joint is jogged at a velocity that is no number",
            LEAD,
        ),
        (
            "fleet_silent_stays",
            f"{_FLEET}/bridge.py",
            "            self._disappear(place)\n            return\n",
            "            return\n",
            "a node whose heartbeat is lost is still there",
            FLEET,
        ),
        (
            "fleet_emergencies_forgotten",
            f"{_FLEET}/bridge.py",
            ".append(emergency)",
            "",
            "who comes later hears of no emergency",
            FLEET,
        ),
        (
            "fleet_first_node_alone",
            f"{_FLEET}/bridge.py",
            "[each for each in self.alive if each.bus == name]",
            "[each for each in self.alive if each.bus == name][:1]",
            "a query for all nodes is answered for one",
            FLEET,
        ),
        (
            "fleet_error_is_a_value",
            f"{_FLEET}/fleet.py",
            "        if refused is not None and not answers:\n            raise refused\n",
            "",
            "what a node refused looks as if its bridge were away",
            FLEET,
        ),
        (
            "fleet_wild_write",
            f"{_FLEET}/fleet.py",
            '            raise ValueError(f"{where} is many nodes; this is for one")\n',
            "            pass\n",
            "a write to all nodes goes out",
            FLEET,
        ),
        (
            "fleet_any_address",
            f"{_FLEET}/joining.py",
            '        return ipaddress.ip_address(host.strip("[]")).is_loopback\n',
            '        return not ipaddress.ip_address(host.strip("[]")).is_multicast\n',
            "a bridge without passwords listens to other computers",
            FLEET,
        ),
        (
            "fleet_page_asks_no_guard",
            _SUBJECT,
            "        self.guard.require_write(*place)\n        self._require_one_bridge(net)\n",
            "        self._require_one_bridge(net)\n",
            "a page without --allow writes wherever a bridge allows it",
            PICTURE,
        ),
        (
            "fleet_page_trusts_a_name",
            _SUBJECT,
            "        self.guard.require_write(*place)\n        return place\n",
            "        return place\n",
            "a bridge calls the controlword by a harmless name, and a page that may write settings moves a drive",
            PICTURE,
        ),
        (
            "fleet_page_moves",
            _SUBJECT,
            "NEVER_ALLOWED: Final = frozenset({Permission.MOTION, Permission.LSS})",
            "NEVER_ALLOWED: Final = frozenset({Permission.LSS})",
            "a page writes controlwords over a wide network, without a lease",
            FLEET_WEB,
        ),
        (
            "fleet_page_silent_halt",
            _SUBJECT,
            '        problems += [f"{each} did not answer" for each in there if each not in answered]\n',
            "",
            "a halt counts as done though a site has not answered",
            FLEET_WEB,
        ),
        (
            "fleet_page_lost_halt",
            _SUBJECT,
            "for each in lost if net in (None, each)]",
            "for each in ()]",
            "a halt counts as done though a site is lost",
            FLEET_WEB,
        ),
        (
            "fleet_halt_of_nonsense",
            f"{_FLEET}/fleet.py",
            '        return ["its bridge does not say whether all stands"]\n',
            "        return []\n",
            "an answer that is nonsense confirms that all stands",
            PICTURE,
        ),
        (
            "fleet_halt_of_two",
            f"{_FLEET}/fleet.py",
            "            found.setdefault(answer.place, []).extend(_problems(answer.data))\n",
            "            found[answer.place] = _problems(answer.data)\n",
            "a second answer for a place hides that something still moves",
            PICTURE,
        ),
        (
            "fleet_page_stamp_unlooked_at",
            _PICTURE,
            " or not 0 <= stamp < 1 << 64:",
            ":",
            "a bridge ends the values of a page by a time of four thousand digits",
            PICTURE,
        ),
        (
            "fleet_page_number_of_another",
            _PICTURE,
            "        return next((str(each.place) for each in self._buses.values() if each.number == number), None)\n",
            "        return self.names[number - 1] if 0 < number <= len(self.names) else None\n",
            "a site comes, and a page then writes to another bus than the one that it shows",
            PICTURE,
        ),
        (
            "fleet_page_late_is_there",
            _PICTURE,
            "LATE if silent > LATE_STATUS else THERE",
            "THERE",
            "a bridge that says nothing any more looks live",
            PICTURE,
        ),
        (
            "fleet_page_lost_looks_alive",
            _PICTURE,
            "        is_lost = not (bus.is_there and node.is_there)\n",
            "        is_lost = not node.is_there\n",
            "the nodes of a site that is lost look as they were",
            PICTURE,
        ),
        (
            "fleet_page_text_uncleaned",
            _PICTURE,
            'node.name = clean(name, MOST_NAME) if isinstance(name, str) else ""',
            'node.name = name if isinstance(name, str) else ""',
            "a bridge sends a name of a million characters to each page",
            PICTURE,
        ),
        (
            "fleet_page_hears_all_pdos",
            f"{_FLEET}/fleet.py",
            "                    yield key_of(pattern.bus_place if news is FleetStatus else pattern, *rest)\n",
            "                    yield key_of(pattern.bus_place if news is FleetStatus else EVERYWHERE, *rest)\n",
            "one watched value brings the PDOs of all sites over the network",
            FLEET_WEB,
        ),
    )
)
