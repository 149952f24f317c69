"""All uses of a robot by a script with ur_rtde: reads states, switches outputs, moves the arm, loses the connection.

Usage: ur_rtde_client.py ADDRESS. Prints one line per step; "please: ..." asks the caller to do something to the robot
and waits for a line on standard input. Exit code 0 when all of it worked.
"""

import os
import sys
import time

import dashboard_client
import rtde_control
import rtde_io
import rtde_receive

ADDRESS = sys.argv[1]
PATIENCE_S = 20.0


def say(line):
    print(line, flush=True)


def check(holds, what):
    if not holds:
        say(f"FAILED: {what}")
        # The interfaces' threads do not always end by themselves.
        os._exit(1)
    say(f"ok: {what}")


def wait(condition, what):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            check(False, what)
        time.sleep(0.002)
    say(f"ok: {what}")


def please(what):
    say(f"please: {what}")
    sys.stdin.readline()


def near(a, b, tolerance):
    return max(abs(x - y) for x, y in zip(a, b)) < tolerance


receive = rtde_receive.RTDEReceiveInterface(ADDRESS)
check(receive.isConnected(), "receive interface connects")
start = receive.getTimestamp()
wait(lambda: receive.getTimestamp() > start + 0.1, "time goes on")
check(len(receive.getActualQ()) == 6, "six joints")
check(receive.getRobotMode() == 7 and receive.getSafetyMode() == 1, "running and normal")

io = rtde_io.RTDEIOInterface(ADDRESS)
check(io.setStandardDigitalOut(2, True), "digital output set")
wait(lambda: receive.getDigitalOutState(2), "and read back")
check(io.setAnalogOutputVoltage(0, 0.5), "analog output set")
wait(lambda: abs(receive.getStandardAnalogOutput0() - 5.0) < 1e-6, "and read back")
check(io.setSpeedSlider(0.5), "speed slider set")
wait(lambda: abs(receive.getTargetSpeedFraction() - 0.5) < 1e-9, "and read back")
check(io.setSpeedSlider(1.0), "speed slider set back")
wait(lambda: receive.getTargetSpeedFraction() == 1.0, "and read back")

control = rtde_control.RTDEControlInterface(ADDRESS)
check(control.isProgramRunning(), "control script runs")
home = receive.getActualQ()

goal = list(home)
goal[0] += 0.3
check(control.moveJ(goal, 1.0, 2.0), "moveJ")
wait(lambda: near(receive.getActualQ(), goal, 2e-3), "the arm is there")

check(control.speedJ([-0.3, 0, 0, 0, 0, 0], 2.0), "speedJ")
wait(lambda: abs(receive.getActualQd()[0] + 0.3) < 1e-2, "the arm moves at that speed")
check(control.speedStop(), "speedStop")
wait(lambda: max(map(abs, receive.getActualQd())) < 1e-3, "the arm stands")

target = receive.getActualQ()
for _ in range(100):
    begin = control.initPeriod()
    target[1] -= 0.001
    control.servoJ(target, 0.0, 0.0, 0.008, 0.1, 300)
    control.waitPeriod(begin)
wait(lambda: near(receive.getActualQ(), target, 2e-3), "servoJ leads the arm along")
check(control.servoStop(), "servoStop")

pose = receive.getActualTCPPose()
pose[2] += 0.05
check(control.moveL(pose, 0.2, 1.0), "moveL")
wait(lambda: near(receive.getActualTCPPose()[:3], pose[:3], 2e-3), "the tool is there")
check(control.speedL([0, 0, -0.05, 0, 0, 0], 0.5), "speedL")
wait(lambda: abs(receive.getActualTCPSpeed()[2] + 0.05) < 5e-3, "the tool moves at that speed")
check(control.speedStop(), "speedStop")

check(control.moveJ(home, 0.3, 1.0, True), "moveJ, asynchronous")
wait(lambda: max(map(abs, receive.getActualQd())) > 0.1, "the arm is on its way")
control.stopJ(2.0)
wait(lambda: max(map(abs, receive.getActualQd())) < 1e-3, "the arm stands")
check(control.moveJ(home, 1.0, 2.0), "moveJ back")
path = [home[:], home[:]]
path[0][0] += 0.2
path[1][2] -= 0.1
check(control.moveJ([q + [1.0, 2.0, 0.0] for q in path]), "moveJ along a path, a script of its own")
wait(lambda: near(receive.getActualQ(), path[-1], 2e-3), "the arm is at the path's end")
check(control.moveJ(home, 1.0, 2.0), "moveJ back")

up = [0.0, 0.0, 20.0, 0.0, 0.0, 0.0]
control.forceModeSetDamping(0.1)
check(control.forceMode([0.0] * 6, [0, 0, 1, 0, 0, 0], up, 2, [0.02] * 6), "forceMode")
wait(lambda: receive.getActualTCPSpeed()[2] > 5e-3, "the tool moves along the compliant axis")
check(control.forceModeStop(), "forceModeStop")
wait(lambda: max(map(abs, receive.getActualQd())) < 1e-3, "the arm stands")
check(control.teachMode(), "teachMode")
check(max(map(abs, receive.getActualQd())) < 1e-3, "the arm stays where no hand guides it")
check(control.endTeachMode(), "endTeachMode")
check(control.freedriveMode(), "freedriveMode")
check(control.endFreedriveMode(), "endFreedriveMode")
check(control.setPayload(1.0, [0.0, 0.0, 0.05]), "setPayload")
wait(lambda: abs(receive.getPayload() - 1.0) < 1e-6, "and read back")
check(control.moveJ(home, 1.0, 2.0), "moveJ back")
found = control.getInverseKinematics(receive.getActualTCPPose(), home)
check(near(found, home, 5e-3), "inverse kinematics")

check(control.setWatchdog(5.0), "setWatchdog")
control.speedJ([0.1, 0, 0, 0, 0, 0], 1.0)
for _ in range(50):
    control.kickWatchdog()
    time.sleep(0.02)
check(receive.getSafetyMode() == 1, "a fed watchdog is quiet")
wait(lambda: receive.getSafetyMode() == 3, "an unfed watchdog stops the robot")
# Its two interfaces have a connection each.
wait(lambda: not control.isProgramRunning(), "and its program is gone")
wait(lambda: max(map(abs, receive.getActualQd())) < 1e-3, "and it stands")

dashboard = dashboard_client.DashboardClient(ADDRESS)
dashboard.connect()
check("RUNNING" in dashboard.robotmode(), "dashboard: running")
# No sooner than 5 s after the stop.
began = receive.getTimestamp()
wait(lambda: receive.getTimestamp() > began + 5.1, "5 s have passed")
dashboard.closeSafetyPopup()
dashboard.unlockProtectiveStop()
wait(lambda: receive.getSafetyMode() == 1, "dashboard: unlocked")
check(max(map(abs, receive.getActualQd())) < 1e-3, "nothing moves by itself")
control.disconnect()
control = rtde_control.RTDEControlInterface(ADDRESS)
check(control.moveJ(home, 1.0, 2.0), "a new control interface moves it again")
control.stopScript()
wait(lambda: not control.isProgramRunning(), "stopScript")
control.disconnect()
io.disconnect()

please("restart")
wait(lambda: not receive.isConnected(), "a restart cuts the connection")
wait(receive.reconnect, "and it can be made again")
check(receive.getTimestamp() < 60, "time began anew")
say("all done")
sys.stdout.flush()
os._exit(0)
