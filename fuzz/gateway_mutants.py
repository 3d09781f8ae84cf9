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
COMMANDS: Final = ("tests/gateway/test_ascii_commands.py",)
LSS: Final = ("tests/gateway/test_ascii_lss.py",)
DOOR: Final = ("tests/gateway/test_ascii_door.py",)
NETS: Final = ("tests/gateway/test_several_nets.py",)
FLEET: Final = ("tests/gateway/test_fleet.py",)
LEAD: Final = ("tests/gateway/test_fleet_lead.py",)
WEB: Final = ("tests/gateway/test_web_guard.py",)
LIVE: Final = ("tests/gateway/test_web_live.py",)
ASSISTANT: Final = ("tests/gateway/test_assistant.py",)

_GUARD: Final = "canopen_gateway/guard.py"
_LEASE: Final = "canopen_gateway/lease.py"
_SERVICE: Final = "canopen_gateway/service.py"
_DOOR: Final = "canopen_gateway/ascii/door.py"
_WEB: Final = "canopen_gateway/web/guard.py"
_LIVE: Final = "canopen_gateway/web/live.py"
_CONNECTION: Final = "canopen_gateway/ascii/connection.py"
_FLEET: Final = "canopen_gateway/fleet"

GATEWAY_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
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
            "                lease.renew(session, _sequence(message))\n",
            "                lease.renew(lease.owner or session, _sequence(message))\n",
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
            '                self.service.lease.require_free(self, f"writing 0x{index:04X}:{subindex:02X}")\n',
            "",
            "a client writes the controlword of a drive that another one moves",
            LEASE,
        ),
        (
            "impatience_reaches_the_chain",
            _SERVICE,
            "                if timeout is not None and not self._is_moved(node):\n",
            "                if timeout is not None:\n",
            "a client that waits a millisecond only stops the chain whose joint it asks",
            SERVICE,
        ),
        (
            "time_out_stays",
            _SERVICE,
            "                    client.timeout, client.max_upload = before\n",
            "                    client.max_upload = before[1]\n",
            "the time-out of one client counts for all who come after it",
            COMMANDS,
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
            "                        nursery.start_soon(self._halted, name, chain.halt, problems)\n        if moved",
            "                        pass\n        if moved",
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
    )
)
