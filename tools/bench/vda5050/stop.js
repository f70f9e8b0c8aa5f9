// Presses stop as a master control does, once for each line on stdin: the instant action `stop`.
//
//   node stop.js BROKER_URL
//
// It prints one JSON line when it is ready, and one for each press at the moment of its publication.
const { MasterController, BlockingType, Topic } = require("vda-5050-lib");
const readline = require("readline");
const master = new MasterController(
    { interfaceName: "uagv", transport: { brokerUrl: process.argv[2] }, vdaVersion: "2.0.0" }, {});

(async () => {
    await master.start();
    await new Promise((resolve) => master.trackAgvs((agvId, state) => {
        if (agvId.serialNumber === "robot0" && state === "ONLINE") resolve();
    }));
    console.log(JSON.stringify({ ready: true }));
    let count = 0;
    for await (const _ of readline.createInterface({ input: process.stdin })) {
        const actions = { instantActions: [
            { actionId: `stop-${++count}`, actionType: "stop", blockingType: BlockingType.Hard }] };
        await master.publish(Topic.InstantActions, { manufacturer: "Headland", serialNumber: "robot0" }, actions);
        console.log(JSON.stringify({ pressed: count }));
    }
})();
