"""What passes on a bus, understood by somebody who only listens: no frame is sent, and nothing is known but what was heard."""
