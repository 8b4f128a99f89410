"""Agents in a process of their own, under bubblewrap: observations go in, actions come out, nothing else.

``docs/threat-model.md`` says what that defends and what it does not.

Outside (the evaluation):

=============  ======================================================================================================
``choosing``   whether an agent is sandboxed, and what its result says about that
``bubblewrap`` how the sandbox is built: files that the agent's process sees, system calls that it may not make
``process``    the process: starting it, talking to it with deadlines, watching its size, ending it
=============  ======================================================================================================

``glbench.evaluation.runners`` puts the process behind the evaluation's ``AgentRunner``, as an agent in this process would be.

Inside: ``worker``, which loads the agent and answers. Both sides share ``frames``: kinds of questions and answers, and the limits.
"""
