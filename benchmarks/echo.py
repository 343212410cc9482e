"""The least that can be done: ATTITUDE in, SET_ATTITUDE_TARGET out, nothing between. Argument: port."""

from __future__ import annotations

import socket
import sys

from pymavlink.dialects.v20 import ardupilotmega as mavlink

LEVEL = (1.0, 0.0, 0.0, 0.0)

if __name__ == "__main__":
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", int(sys.argv[1])))
    mav = mavlink.MAVLink(None, srcSystem=245, srcComponent=191)
    while True:
        data, sender = listener.recvfrom(65535)
        for message in mav.parse_buffer(data) or []:
            if message.get_type() == "ATTITUDE":
                answer = mavlink.MAVLink_set_attitude_target_message(
                    message.time_boot_ms, 1, 1, 128, LEVEL, 0.0, 0.0, 0.0, 0.4
                )
                listener.sendto(answer.pack(mav), sender)
