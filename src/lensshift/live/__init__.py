"""The live page: frames come in, a picture is made after each, a browser shows the latest one."""
