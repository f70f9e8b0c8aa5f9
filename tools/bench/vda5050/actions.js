// An independent master control (vda-5050-lib) that pauses vehicles, takes an order back, lets one be
// delivered, and asks for one back whose parcel is aboard.
//
//   node actions.js BROKER_URL MAP_ID VEHICLES
//
// It prints one JSON line for each step as it ends, and then {"over": true}.
const { MasterController, Topic, BlockingType } = require("vda-5050-lib");
const [url, mapId, count] = process.argv.slice(2);
const say = (event) => console.log(JSON.stringify(event));
const master = new MasterController(
    { interfaceName: "uagv", transport: { brokerUrl: url }, vdaVersion: "2.0.0" }, {});
const states = new Map();  // serial number -> its newest state
const waiting = [];  // [condition on the states, what to do then]
let actions = 0;

const agv = (serial) => ({ manufacturer: "Headland", serialNumber: serial });
const when = (holds) => new Promise((done) => { waiting.push([holds, done]); look(); });
function look() {
    for (const entry of [...waiting]) {
        if (entry[0]()) { waiting.splice(waiting.indexOf(entry), 1); entry[1](); }
    }
}

// The end of an instant action: FINISHED or FAILED, as the controller is told.
const act = (serial, actionType) => new Promise((done) => master.initiateInstantActions(
    agv(serial),
    { instantActions: [{ actionId: `a${++actions}`, actionType, blockingType: BlockingType.Hard }] },
    {
        onActionStateChanged: (state) => {
            if (["FINISHED", "FAILED"].includes(state.actionStatus)) done(state.actionStatus);
        },
        onActionError: (error) => done(`error: ${error.errorDescription}`),
    }));

function order(id, from, to) {
    const node = (name, sequenceId, [x, y], actionType) => ({
        nodeId: `${id}-${name}`, sequenceId, released: true, nodePosition: { x, y, mapId },
        actions: [{ actionId: `${id}-${actionType}`, actionType, blockingType: BlockingType.Hard }],
    });
    return {
        orderId: id, orderUpdateId: 0, nodes: [node("a", 0, from, "pick"), node("b", 2, to, "drop")],
        edges: [{ edgeId: `${id}-e`, sequenceId: 1, released: true, startNodeId: `${id}-a`,
                  endNodeId: `${id}-b`, actions: [] }],
    };
}

// An order: `picked` when its parcel is aboard, `over` with what its controller was told at the end.
function give(serial, id, from, to) {
    let picked;
    const job = { picked: new Promise((done) => { picked = done; }) };
    job.over = new Promise((done) => master.assignOrder(agv(serial), order(id, from, to), {
        onActionStateChanged: (state, _, action) => {
            if (action.actionType === "pick" && state.actionStatus === "FINISHED") picked();
        },
        onOrderProcessed: (error, byCancelation, active) => {
            if (!active) done({ failed: !!error, cancelled: byCancelation });
        },
    }));
    return job;
}

const taken = (serial, id) => when(() => (states.get(serial) || {}).orderId === id);
const word = (serial) => ((states.get(serial).information || []).find((i) => i.infoType === "transport")
    || { infoReferences: [] }).infoReferences.filter((r) => r.referenceKey === "outcome")
    .map((r) => r.referenceValue)[0];

(async () => {
    await master.start();
    await master.subscribe(Topic.State, {}, (state, id) => { states.set(id.serialNumber, state); look(); });
    const serials = Array.from({ length: Number(count) }, (_, k) => `robot${k}`);
    await when(() => serials.every((s) => states.has(s) && states.get(s).paused === false));
    for (const serial of serials) say({ pause: await act(serial, "startPause") });
    await when(() => serials.every((s) => states.get(s).paused === true));
    const first = give("robot0", "back", [0.5, 0.5], [5.5, 4.5]);
    await taken("robot0", "back");
    say({ cancel: await act("robot0", "cancelOrder") });
    await when(() => word("robot0") === "withdrawn");
    say({ withdrawn: word("robot0"), states: states.get("robot0").nodeStates.length });
    for (const serial of serials) say({ resume: await act(serial, "stopPause") });
    await when(() => serials.every((s) => states.get(s).paused === false));
    const second = give("robot1", "aboard", [0.5, 0.5], [11.5, 4.5]);
    await second.picked;
    say({ late: await act("robot1", "cancelOrder") });
    await when(() => word("robot1") === "delivered");
    say({ delivered: word("robot1") });
    const third = give("robot0", "next", [5.5, 0.5], [11.5, 0.5]);
    say({ next: await third.over });
    say({ over: true });
})();
