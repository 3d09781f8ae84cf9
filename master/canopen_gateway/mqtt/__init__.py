"""Telemetry to an MQTT broker: one way, last values retained. Needs the extra `mqtt`. docs/gateway.md has the topics.

door = await bind_mqtt_door("hall-2", parse_broker("mqtts://broker.lan"))
async with open_master(...) as master, open_gateway(master) as service:
    await door.serve(service)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.mqtt.broker import BrokerAddress as BrokerAddress
    from canopen_gateway.mqtt.broker import BrokerLogin as BrokerLogin
    from canopen_gateway.mqtt.broker import parse_broker as parse_broker
    from canopen_gateway.mqtt.door import MqttDoor as MqttDoor
    from canopen_gateway.mqtt.door import bind_mqtt_door as bind_mqtt_door
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
