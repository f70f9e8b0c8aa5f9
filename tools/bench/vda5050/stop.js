// Presses as a master control does, once for each line on stdin: the instant action that the line names.
// `stop` goes to the first vehicle, and stops the fleet; `startPause` and `stopPause` go to each.
//
//   node stop.js BROKER_URL VEHICLES
//
// It prints one JSON line when all vehicles are online, and one for each line at the moment of its publication.
const { MasterController, BlockingType, Topic } = require("vda-5050-lib");
const readline = require("readline");
const [brokerUrl, count] = process.argv.slice(2);
const master = new MasterController(
    { interfaceName: "uagv", transport: { brokerUrl }, vdaVersion: "2.0.0" }, {});
const all = [...Array(Number(count)).keys()].map((k) => `robot${k}`);

(async () => {
    await master.start();
    const online = new Set();
    await new Promise((resolve) => master.trackAgvs((agvId, state) => {
        if (state === "ONLINE") online.add(agvId.serialNumber);
        if (online.size === all.length) resolve();
    }));
    console.log(JSON.stringify({ ready: true }));
    let presses = 0;
    for await (const actionType of readline.createInterface({ input: process.stdin })) {
        ++presses;
        await Promise.all((actionType === "stop" ? all.slice(0, 1) : all).map((serialNumber) => master.publish(
            Topic.InstantActions, { manufacturer: "Headland", serialNumber },
            { instantActions: [
                { actionId: `${actionType}-${presses}`, actionType, blockingType: BlockingType.Hard }] })));
        console.log(JSON.stringify({ pressed: presses }));
    }
})();
