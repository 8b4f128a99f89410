"""Agents in a process of their own, under bubblewrap: observations go in, actions come out, nothing else.

``docs/threat-model.md`` says what that defends and what it does not.

Outside (the evaluation):

=============  ======================================================================================================
``choosing``   whether an agent is sandboxed, and what its result says about that
``bubblewrap`` the command line that builds the sandbox, and why it cannot be built here
``visible``    the files that the agent's process sees
``syscalls``   the system calls that it may not make
``process``    the process: starting it, talking to it with deadlines, watching its size, ending it
``drivers``    the process behind the evaluation's ``AgentRunner``, as an agent in this process would be
=============  ======================================================================================================

Inside: ``guest``, which loads the agent and answers. Both sides share ``frames`` and the ``limits``.
"""
