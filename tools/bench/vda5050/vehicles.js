// Vehicles of an independent implementation (the virtual AGV of vda-5050-lib), started by a test.
//
//   node vehicles.js BROKER_URL MAP_ID STARTS SPEED_M_S
//
// STARTS: JSON, [[x, y], ...] in metres, one vehicle each. It prints one JSON line for each parcel that is
// picked or dropped, as the vehicle does it.
const { AgvController, VirtualAgvAdapter } = require("vda-5050-lib");
const [url, mapId, startsText, speed] = process.argv.slice(2);
const say = (event) => console.log(JSON.stringify(event));

class WatchedAgv extends VirtualAgvAdapter {
    executeAction(context) {
        const update = context.updateActionStatus;
        context.updateActionStatus = (change) => {
            const { actionType, actionDescription } = context.action;
            if (change.actionStatus === "FINISHED" && ["pick", "drop"].includes(actionType)) {
                const { x, y } = this.vehicleState.position;
                say({ [actionType]: actionDescription, by: this.serial, x, y });
            }
            update(change);
        };
        super.executeAction(context);
    }
}

(async () => {
    for (const [k, [x, y]] of JSON.parse(startsText).entries()) {
        const serial = `v${k}`;
        const agv = new AgvController(
            { manufacturer: "Independent", serialNumber: serial },
            { interfaceName: "uagv", transport: { brokerUrl: url, reconnectPeriod: 300 }, vdaVersion: "2.0.0" },
            { agvAdapterType: class extends WatchedAgv { get serial() { return serial; } },
              publishStateInterval: 1000, publishVisualizationInterval: 100 },
            { initialPosition: { mapId, x, y, theta: 0, lastNodeId: "start" }, vehicleSpeed: Number(speed),
              tickRate: 40 });
        await agv.start();
    }
    say({ started: JSON.parse(startsText).length });
})();
