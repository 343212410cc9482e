"""The MAVLink side of the simulated autopilot, sans-I/O: frames in, frames out, per peer.

Commands are in `commands`, telemetry in `telemetry`; here are the peers, the dispatch and the small
protocols: setpoints, parameters, missions, data streams, time synchronisation.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Hashable
from typing import TypeAlias

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle import frames, stream_rates, telemetry
from sim_vehicle.commands import Commands
from sim_vehicle.firmware import AttitudeSetpoint, Firmware, Severity
from sim_vehicle.guidance import Estimate
from sim_vehicle.parameters import WIRE_TYPE
from sim_vehicle.peer import COMPONENT_ID, Peer
from sim_vehicle.signing import Signing
from sim_vehicle.telemetry import Message

PARAMETER_SLOWDOWN = 4
"""ArduCopter's streams are this much slower while it sends its parameter list."""

HASH_PARAMETER = "_HASH_CHECK"
"""Answered by PX4: a checksum of all parameters, so that ground stations can use their cache."""

FTP_NAK, FTP_UNKNOWN_COMMAND, FTP_NO_SUCH_FILE = 129, 7, 10
FTP_ABOUT_FILES = (3, 4, 14)
"""List a directory, open a file to read, checksum of a file."""

Handler: TypeAlias = Callable[[Peer, Message], None]


class MavlinkServer:
    """Peers, streams and protocols of one vehicle; with `signing`, only genuine frames count."""

    def __init__(
        self, firmware: Firmware, system_id: int, loop_rate_hz: float, signing: Signing | None = None
    ) -> None:
        self.firmware = firmware
        self.system_id = system_id
        self.time_us = 0
        self.px4 = firmware.autopilot == mavlink.MAV_AUTOPILOT_PX4
        self.defaults = stream_rates.PX4_DEFAULT_HZ if self.px4 else stream_rates.ARDUPILOT_DEFAULT_HZ
        self.estimate = firmware.estimate
        self.missions: dict[int, list[Message]] = {}
        # Until somebody is known, everybody may listen.
        self._signing = signing
        self._links = 0
        self.peers: dict[Hashable | None, Peer] = {None: self._new_peer(None)}
        self._later: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0
        self._text_count = 0
        self.commands = Commands(self, loop_rate_hz)
        self._handlers: dict[str, Handler] = {
            "COMMAND_LONG": self.commands.handle_long,
            "COMMAND_INT": self.commands.handle_int,
            "SET_MODE": self.commands.handle_set_mode,
            "SET_ATTITUDE_TARGET": self._set_attitude_target,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_SET": self._parameter_set,
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_REQUEST_INT": self._mission_item,
            "MISSION_REQUEST": self._mission_item,
            "MISSION_COUNT": self._mission_upload,
            "MISSION_ITEM_INT": self._mission_received,
            "MISSION_ITEM": self._mission_received,
            "MISSION_CLEAR_ALL": self._mission_clear,
            "MISSION_SET_CURRENT": self._mission_set_current,
            "REQUEST_DATA_STREAM": self._data_stream,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "FILE_TRANSFER_PROTOCOL": self._ftp,
            "LOG_REQUEST_LIST": self._log_list,
        }

    # ------------------------------------------------------------------------------ in and out

    def add_peer(self, key: Hashable) -> Peer:
        """The peer of that key, with default streams if it is new."""
        if key not in self.peers:
            self.peers.pop(None, None)
            self.peers[key] = self._new_peer(key)
        return self.peers[key]

    def _new_peer(self, key: Hashable | None) -> Peer:
        peer = Peer(key, self.system_id, self.defaults, self.time_us, self._signing, self._links)
        self._links += 1
        return peer

    def remove_peer(self, key: Hashable) -> None:
        """Forget a peer and its streams."""
        self.peers.pop(key, None)

    def receive(self, key: Hashable, data: bytes) -> None:
        """Handle what a peer sent, at the present time."""
        peer = self.add_peer(key)
        for message in peer.parse(data):
            self._pass_on(peer, message)
            handler = self._handlers.get(message.get_type())
            if handler is not None and self._is_for_us(message):
                handler(peer, message)

    def _pass_on(self, peer: Peer, message: Message) -> None:
        """Between peers, as both firmwares do between their links: what is not for the autopilot alone."""
        frame = bytes(message.get_msgbuf())
        at = 5 if frame[0] == mavlink.PROTOCOL_MARKER_V2 else 3
        source = frame[at], frame[at + 1]  # pymavlink does not tell it of messages that it does not know
        target = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        peer.heard.add(source)
        if (self.system_id, COMPONENT_ID) in (source, target):
            return
        for other in self.peers.values():
            if other is not peer and other.leads_to(*target):
                other.pass_on(frame)

    def _is_for_us(self, message: Message) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.system_id) and component in (0, COMPONENT_ID)

    def after(self, delay_us: int, action: Callable[[], None]) -> None:
        """Do something `delay_us` of simulated time from now, in order."""
        self._count += 1
        heapq.heappush(self._later, (self.time_us + delay_us, self._count, action))

    def run_due(self, time_us: int) -> None:
        """Advance the clock and do what is due."""
        self.time_us = time_us
        while self._later and self._later[0][0] <= time_us:
            heapq.heappop(self._later)[2]()

    def emit(self, estimate: Estimate) -> list[tuple[Hashable | None, bytes]]:
        """Everything to be sent at the time of `estimate`, as datagrams per peer."""
        self.time_us, self.estimate = estimate.time_us, estimate
        self._send_texts()
        busy = [peer for peer in self.peers.values() if peer.has_work(estimate.time_us)]
        if not busy:
            return []
        sample = telemetry.Sample(self.firmware, estimate)
        built: dict[int, Message | None] = {}
        datagrams: list[tuple[Hashable | None, bytes]] = []
        for peer in busy:
            slowdown = PARAMETER_SLOWDOWN if peer.parameter_queue and not self.px4 else 1
            for message_id in peer.due_messages(estimate.time_us, slowdown):
                if message_id not in built:
                    built[message_id] = self.build(message_id, sample)
                message = built[message_id]
                if message is not None:
                    peer.send(message)
            if peer.parameter_queue:
                self.send_parameter(peer, peer.parameter_queue.popleft())
            datagrams += [(peer.key, datagram) for datagram in peer.take_datagrams()]
        return datagrams

    def build(self, message_id: int, sample: telemetry.Sample | None = None) -> Message | None:
        """A telemetry message, or None if there is none of that id, or nothing to say yet."""
        builder = telemetry.BUILDERS.get(message_id)
        if builder is None:
            return None
        if message_id in telemetry.SENT_WHEN_SETTLED and not self.firmware.settled:
            return None
        return builder(sample or telemetry.Sample(self.firmware, self.estimate))

    def _send_texts(self) -> None:
        for severity, text in self.firmware.texts:
            self._text_count = self._text_count % 65535 + 1
            for message in telemetry.status_texts(int(severity), text, self._text_count):
                for peer in self.peers.values():
                    peer.send(message)
        self.firmware.texts.clear()

    # ------------------------------------------------------------------------------- setpoints

    def _set_attitude_target(self, peer: Peer, message: Message) -> None:
        p, q, r = frames.flipped((message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate))
        w, x, y, z = frames.flipped(message.q)
        self.firmware.accept_setpoint(
            AttitudeSetpoint(int(message.type_mask), (w, x, y, z), (p, q, r), float(message.thrust))
        )

    # ------------------------------------------------------------------------------ parameters

    def send_parameter(self, peer: Peer, name: str) -> None:
        """PARAM_VALUE of one parameter (or of PX4's checksum)."""
        store = self.firmware.parameters
        if name == HASH_PARAMETER:
            value = float(np.array([store.checksum()], dtype="<u4").view("<f4")[0])
            kind, index = mavlink.MAV_PARAM_TYPE_UINT32, 65535
        else:
            value, kind = store.to_wire(name), WIRE_TYPE[store.kind(name)]
            index = store.names.index(name)
        peer.send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(store.names), index))

    def _parameter_list(self, peer: Peer, message: Message) -> None:
        peer.parameter_queue.clear()
        if self.px4:
            peer.parameter_queue.append(HASH_PARAMETER)
        peer.parameter_queue.extend(self.firmware.parameters.names)

    def _parameter_read(self, peer: Peer, message: Message) -> None:
        store = self.firmware.parameters
        if message.param_index >= 0:
            if message.param_index < len(store.names):
                self.send_parameter(peer, store.names[message.param_index])
            return
        name = str(message.param_id).rstrip("\x00")
        if name in store or (self.px4 and name == HASH_PARAMETER):
            self.send_parameter(peer, name)

    def _parameter_set(self, peer: Peer, message: Message) -> None:
        store = self.firmware.parameters
        name = str(message.param_id).rstrip("\x00")
        if self.px4 and name == HASH_PARAMETER:
            peer.parameter_queue.clear()  # the ground station has them all in its cache
            return
        if name not in store:
            self.firmware.texts.append((Severity.WARNING, f"unknown param: {name}"))
            return
        try:
            store.set(name, store.from_wire(name, float(message.param_value), int(message.param_type)))
        except ValueError as problem:
            self.firmware.texts.append((Severity.WARNING, f"param {name}: {problem}"))
        for listener in self.peers.values():
            self.send_parameter(listener, name)

    # --------------------------------------------------------------------------------- mission

    def _mission_list(self, peer: Peer, message: Message) -> None:
        count = len(self.missions.get(int(message.mission_type), []))
        peer.send(
            mavlink.MAVLink_mission_count_message(
                message.get_srcSystem(), message.get_srcComponent(), count, message.mission_type
            )
        )

    def _mission_item(self, peer: Peer, message: Message) -> None:
        items = self.missions.get(int(message.mission_type), [])
        if message.seq >= len(items):
            self._mission_ack(peer, message, mavlink.MAV_MISSION_INVALID_SEQUENCE)
            return
        item = items[message.seq]
        item.target_system, item.target_component = message.get_srcSystem(), message.get_srcComponent()
        peer.send(item)

    def _mission_upload(self, peer: Peer, message: Message) -> None:
        peer.upload, peer.upload_type = [None] * int(message.count), int(message.mission_type)
        if message.count == 0:
            self.missions[peer.upload_type] = []
            self._mission_ack(peer, message, mavlink.MAV_MISSION_ACCEPTED)
            return
        self._mission_request(peer, message, 0)

    def _mission_received(self, peer: Peer, message: Message) -> None:
        if message.seq >= len(peer.upload):
            self._mission_ack(peer, message, mavlink.MAV_MISSION_INVALID_SEQUENCE)
            return
        peer.upload[message.seq] = message
        if None in peer.upload:
            self._mission_request(peer, message, peer.upload.index(None))
            return
        self.missions[peer.upload_type] = list(peer.upload)
        peer.upload = []
        self._mission_ack(peer, message, mavlink.MAV_MISSION_ACCEPTED)

    def _mission_request(self, peer: Peer, message: Message, sequence: int) -> None:
        peer.send(
            mavlink.MAVLink_mission_request_int_message(
                message.get_srcSystem(), message.get_srcComponent(), sequence, peer.upload_type
            )
        )

    def _mission_clear(self, peer: Peer, message: Message) -> None:
        if message.mission_type == mavlink.MAV_MISSION_TYPE_ALL:
            self.missions.clear()
        self.missions.pop(int(message.mission_type), None)
        self._mission_ack(peer, message, mavlink.MAV_MISSION_ACCEPTED)

    def _mission_set_current(self, peer: Peer, message: Message) -> None:
        peer.send(mavlink.MAVLink_mission_current_message(message.seq))

    def _mission_ack(self, peer: Peer, message: Message, result: int) -> None:
        peer.send(
            mavlink.MAVLink_mission_ack_message(
                message.get_srcSystem(), message.get_srcComponent(), result, message.mission_type
            )
        )

    # ----------------------------------------------------------------------------------- other

    def _data_stream(self, peer: Peer, message: Message) -> None:
        """REQUEST_DATA_STREAM; PX4 has none."""
        if self.px4:
            return
        wanted = int(message.req_stream_id)
        groups = stream_rates.DATA_STREAMS
        chosen = groups.values() if wanted == mavlink.MAV_DATA_STREAM_ALL else [groups.get(wanted, ())]
        rate = int(message.req_message_rate) if message.start_stop else 0
        for message_id in (entry for group in chosen for entry in group):
            peer.set_interval(message_id, 1_000_000 // rate if rate > 0 else 0, self.time_us)

    def _timesync(self, peer: Peer, message: Message) -> None:
        if message.tc1 == 0:
            peer.send(mavlink.MAVLink_timesync_message(max(1, self.time_us * 1000), message.ts1))

    def _ping(self, peer: Peer, message: Message) -> None:
        if message.target_system == 0:
            peer.send(
                mavlink.MAVLink_ping_message(
                    message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
                )
            )

    def _ftp(self, peer: Peer, message: Message) -> None:
        """No files here: say so, so that clients fall back at once instead of waiting.

        QGroundControl does only if it is the file that is missing, not the command.
        """
        request = bytes(message.payload)
        answer = bytearray(251)
        answer[0:2] = (int.from_bytes(request[0:2], "little") + 1 & 0xFFFF).to_bytes(2, "little")
        answer[2] = request[2]
        answer[3:7] = bytes((FTP_NAK, 1, request[3], 0))
        answer[12] = FTP_NO_SUCH_FILE if request[3] in FTP_ABOUT_FILES else FTP_UNKNOWN_COMMAND
        peer.send(
            mavlink.MAVLink_file_transfer_protocol_message(
                0, message.get_srcSystem(), message.get_srcComponent(), answer
            )
        )

    def _log_list(self, peer: Peer, message: Message) -> None:
        """There are no logs on board: say so, so that clients need not wait."""
        peer.send(mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0))
